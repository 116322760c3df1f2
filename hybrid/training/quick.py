"""Makes a forest for a scene that has none, in minutes."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

from hybrid.frame.irradiance import cache_for
from hybrid.runtime.progress import Bars, console, progress_bar
from hybrid.store.cache import newest_forest, scene_folder, store_forest
from hybrid.store.identity import require_scene
from hybrid.training.forest import train
from pathtrace.dataset.capture import capture
from pathtrace.dataset.frames import FrameSet
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.scene.scene import Scene
from splat.io.forest_file import load_forest
from splat.model.forest import Forest
from splat.training.trainer import TrainingSettings

# They take minutes, and the result is good enough to look at.
QUICK_CAPTURE = CaptureSettings(views=40, held_out=4, spp=16, held_out_spp=64)
QUICK_TRAINING = TrainingSettings(iterations=900, gaussians=30_000)


@dataclass(frozen=True)
class QuickForest:
    """A forest made with the quick settings.

    Attributes:
        forest: the forest.
        frames: what it was trained on.
        seconds: the time that "capture" and "train" took.
    """

    forest: Forest
    frames: FrameSet
    seconds: dict[str, float]


def forest_for(scene: Scene, given: Path | None, bars: Bars = progress_bar) -> Forest:
    """The given forest, else the newest one of the scene in the cache, else one that is trained now.

    Args:
        scene: what the forest is for.
        given: forest file, if the user named one.
        bars: show the progress of capture and training.

    Raises:
        UserError: the file is missing, damaged or belongs to another scene, or no forest can be trained.
    """
    path = given or newest_forest(scene)
    if path is not None:
        forest = load_forest(path)
        require_scene(forest, scene.name, scene.hash, path)
        return forest
    console.print(f"No forest for scene {scene.name} yet: capturing and training one first.")
    return make_quick_forest(scene, scene_folder(scene.name, scene.hash), seed=0, bars=bars).forest


def make_quick_forest(scene: Scene, folder: Path, seed: int, bars: Bars = progress_bar) -> QuickForest:
    """Captures and trains with the quick settings; resumes if interrupted.

    Args:
        scene: what to capture.
        folder: for the frame set and the forest file.
        seed: same seed, same forest on the same machine.
        bars: show the progress of both.
    """
    seconds = {}
    start = time.perf_counter()
    cache = cache_for(scene, bars)
    with bars("capture (samples)") as bar:
        frames = capture(scene, folder / f"frames-{seed}", replace(QUICK_CAPTURE, seed=seed), bar, cache)
    seconds["capture"] = time.perf_counter() - start
    start = time.perf_counter()
    path = folder / f"quick-{seed}.safetensors"
    with bars("train (steps)") as bar:
        forest = train(frames, path, replace(QUICK_TRAINING, seed=seed), bar)
    seconds["train"] = time.perf_counter() - start
    store_forest(forest, path.stem)
    return QuickForest(forest, frames, seconds)
