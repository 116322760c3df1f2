"""Where forests and frame sets lie when no path is given: HYBRID_HOME, else the platform's cache folder."""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import replace
from pathlib import Path

import platformdirs

from hybrid.device import device_arrays
from hybrid.identity import require_scene
from hybrid.progress import Bars, console, progress_bar
from hybrid.training import train_forest
from pathtrace.capture import CaptureSettings, capture
from pathtrace.scene import Scene
from splat.files import load_forest, save_forest
from splat.forest import Forest
from splat.train import TrainingSettings

# What a scene gets that is rendered before it was captured: good enough to look at, in minutes.
QUICK_CAPTURE = CaptureSettings(views=40, held_out=4, spp=16, held_out_spp=64)
QUICK_TRAINING = TrainingSettings(iterations=900, gaussians=30_000)


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


def forest_for(scene: Scene, given: Path | None, bars: Bars = progress_bar) -> Forest:
    """The forest that was asked for, else the newest one of the scene, else one trained now.

    Args:
        scene: what it is for.
        given: a file that was asked for.
        bars: show how far capture and training are.

    Raises:
        UserError: the given file is missing, damaged, one of another scene, or cannot be made.
    """
    path = given or newest_forest(scene)
    if path is not None:
        forest = load_forest(path)
        require_scene(forest, scene.name, scene.hash, path)
        return forest
    console.print(f"No forest for scene {scene.name} yet: capturing and training one first.")
    forest, _ = make_quick_forest(scene, scene_folder(scene.name, scene.hash), seed=0, bars=bars)
    return forest


def make_quick_forest(
    scene: Scene,
    folder: Path,
    seed: int,
    seconds: dict[str, float] | None = None,
    bars: Bars = progress_bar,
) -> tuple[Forest, Path]:
    """Captures and trains with the quick settings.

    Args:
        scene: what to capture.
        folder: frame set and forest lie in it.
        seed: same seed, same forest on the same machine.
        seconds: receives how long "capture" and "train" took.
        bars: show how far both are.

    Returns:
        The forest, and the folder of its frame set.
    """
    seconds = {} if seconds is None else seconds
    frames_folder = folder / f"frames-{seed}"
    start = time.perf_counter()
    with bars("capture (samples)") as bar:
        frames = capture(scene, frames_folder, replace(QUICK_CAPTURE, seed=seed), bar)
    seconds["capture"] = time.perf_counter() - start
    path = folder / f"quick-{seed}.safetensors"
    settings = replace(QUICK_TRAINING, seed=seed)
    with bars("train (steps)") as bar:
        forest, seconds["train"] = train_forest(device_arrays(), frames, path, settings, bar)
    remember_forest(forest, path.stem)
    return forest, frames_folder
