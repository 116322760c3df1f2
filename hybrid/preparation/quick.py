"""Makes a forest for a scene that has none."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from hybrid.plan.values import plan_of_forest, require_plan
from hybrid.preparation.preparation import prepare
from hybrid.preparation.settings import PreparationSettings
from hybrid.runtime.progress import Bars, console, progress_bar
from hybrid.store.cache import newest_forest
from hybrid.store.identity import require_scene
from pathtrace.dataset.frames import FrameSet, read_frame_set
from pathtrace.scene.scene import Scene
from splat.io.forest_file import load_forest
from splat.model.forest import Forest

# Good enough to look at, in a minute and a half.
_QUALITY = "draft"


@dataclass(frozen=True)
class QuickForest:
    """A forest made with the quick settings.

    Attributes:
        forest: the forest.
        frames: what its fusion was fitted to, with held-out views that judge its layers.
        seconds: the time that "prepare" took.
    """

    forest: Forest
    frames: FrameSet
    seconds: dict[str, float]


def forest_for(scene: Scene, given: Path | None, bars: Bars = progress_bar) -> Forest:
    """The given forest, else the newest one of the scene in the cache, else one that is prepared now.

    Args:
        scene: what the forest is for.
        given: forest file, if the user named one.
        bars: show the progress of the preparation.

    Raises:
        UserError: the file is missing, damaged or belongs to another scene, or no forest can be trained.
    """
    path = given or newest_forest(scene)
    if path is not None:
        forest = load_forest(path)
        require_scene(forest, scene.name, scene.hash, path)
        require_plan(plan_of_forest(forest), scene, path)
        return forest
    console.print(f"No forest for scene {scene.name} yet: preparing one first.")
    return prepare(scene, PreparationSettings(quality=_QUALITY, held_out=0), bars).forest


def make_quick_forest(scene: Scene, folder: Path, seed: int, bars: Bars = progress_bar) -> QuickForest:
    """Prepares a forest with the quick settings; resumes if interrupted.

    Args:
        scene: what to prepare.
        folder: for all of its files.
        seed: same seed, same forest on the same machine.
        bars: show the progress.
    """
    start = time.perf_counter()
    settings = PreparationSettings(quality=_QUALITY, held_out=0, seed=seed)
    prepared = prepare(scene, settings, bars, folder / f"prepared-{seed}")
    frames = read_frame_set(folder / f"prepared-{seed}" / "fusion")
    return QuickForest(prepared.forest, frames, {"prepare": time.perf_counter() - start})
