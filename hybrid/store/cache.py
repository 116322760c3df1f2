"""The cache folder for forests, frame sets and measurements: HYBRID_HOME, else the platform's."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import platformdirs

from pathtrace.scene.scene import Scene
from splat.io.forest_file import save_forest
from splat.model.forest import Forest


def home() -> Path:
    """The cache folder; it may not exist yet."""
    chosen = os.environ.get("HYBRID_HOME")
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("hybrid"))


def scene_folder(name: str, digest: str) -> Path:
    """Folder of everything made for one version of a scene, which has that name and hash."""
    return home() / f"{name}-{digest[:12]}"


def store_forest(forest: Forest, name: str) -> None:
    """Stores a copy of a forest in the cache, as the newest one of its scene.

    Raises:
        UserError: the cache folder cannot be written.
    """
    folder = scene_folder(forest.scene_name, forest.scene_hash) / "forests"
    save_forest(folder / f"{name}.safetensors", forest)


def newest_forest(scene: Scene) -> Path | None:
    """File of the forest that was stored last for a scene; None if none was stored."""
    found = {}
    # Hidden files are still being written; another process may rename or remove them meanwhile.
    for path in (scene_folder(scene.name, scene.hash) / "forests").glob("[!.]*.safetensors"):
        with contextlib.suppress(FileNotFoundError):
            found[path] = path.stat().st_mtime
    return max(found, key=lambda path: found[path], default=None)
