"""Where forests and frame sets lie when no path is given: HYBRID_HOME, else the platform's cache folder."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import platformdirs

from pathtrace.scene.scene import Scene
from splat.io.forest_file import save_forest
from splat.model.forest import Forest


def home() -> Path:
    """The cache folder."""
    chosen = os.environ.get("HYBRID_HOME")
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("hybrid"))


def scene_folder(name: str, digest: str) -> Path:
    """Where everything made for one scene lies; another version of the scene has another one."""
    return home() / f"{name}-{digest[:12]}"


def remember_forest(forest: Forest, name: str) -> None:
    """Keeps a copy of a forest that was just trained, so that it is the newest one of its scene.

    Raises:
        UserError: the cache folder cannot be written.
    """
    folder = scene_folder(forest.scene_name, forest.scene_hash) / "forests"
    save_forest(folder / f"{name}.safetensors", forest)


def newest_forest(scene: Scene) -> Path | None:
    """The forest made last for a scene."""
    found = {}
    # Hidden files are those whose writing is not finished; another process may rename or remove them.
    for path in (scene_folder(scene.name, scene.hash) / "forests").glob("[!.]*.safetensors"):
        with contextlib.suppress(FileNotFoundError):
            found[path] = path.stat().st_mtime
    return max(found, key=lambda path: found[path], default=None)
