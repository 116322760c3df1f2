"""A forest for a scene that has none: captured and trained in minutes."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from hybrid.runtime.device import device_arrays
from hybrid.runtime.progress import Bars, console, progress_bar
from hybrid.store.cache import newest_forest, remember_forest, scene_folder
from hybrid.store.identity import require_scene
from hybrid.training.forest import train_forest
from pathtrace.dataset.capture import CaptureSettings, capture
from pathtrace.scene.scene import Scene
from splat.io.forest_file import load_forest
from splat.model.forest import Forest
from splat.training.trainer import TrainingSettings

# What a scene gets that is rendered before it was captured: good enough to look at, in minutes.
QUICK_CAPTURE = CaptureSettings(views=40, held_out=4, spp=16, held_out_spp=64)
QUICK_TRAINING = TrainingSettings(iterations=900, gaussians=30_000)


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
