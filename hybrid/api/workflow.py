"""Loads scenes, frame sets and forests; plans and captures scenes, trains forests, evaluates frames.

`progress` is called with steps done, steps in total, and what is being done, such as "stage 1: frames
(samples)"; each part of a job counts its own steps. All else is logged by the logger "hybrid".
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid.base.progress import Progress, bars_of, no_progress
from pathtrace.scene.backend import select_backend
from pathtrace.trace import Integrator, integrator_named

if TYPE_CHECKING:
    from hybrid.evaluation.evaluation_settings import EvaluationSettings
    from hybrid.preparation.stages import PreparationSettings
    from hybrid.preparation.training_views import Frames
    from pathtrace.dataset.frame_set import CaptureSettings, FrameSet
    from pathtrace.scene.scene import Scene
    from splat.model.forest import Forest
    from splat.training.trainer import TrainingSettings


def load_scene(
    source: str | Path | dict[str, Any],
    *,
    max_depth: int | None = None,
    thin_glass: bool = False,
    motion: str | Path | None = None,
    sensor: str | None = None,
    backend: str = "auto",
) -> Scene:
    """Loads a scene, as its stored plan has it if there is one; renders nothing.

    Plans are stored in the cache folder (`hybrid.plan`, `hybrid.prepare`, `hybrid.capture` and the command
    line make them). A scene with a plan has the path depth and the Russian roulette that are planned for it,
    and thus another hash; one without, those of its file. Rendered with a forest, a scene without a plan
    takes over what was planned for the forest, so that a forest fits a scene wherever it was trained.

    The first call also selects the backend.

    Args:
        source: name of a bundled scene, path of a Mitsuba 3 XML file, or scene dictionary.
        max_depth: path depth, which no plan changes; as planned, else that of the file, if None.
        thin_glass: whether panes of glass let shadow rays pass; such a scene has a hash of its own.
        motion: motion file; the one beside the scene's file by default, if there is one.
        sensor: id of the perspective camera to use; by default the first.
        backend: auto (CUDA if available), cuda or llvm; it cannot change within a process.

    Raises:
        UserError: the scene or its motion is missing or damaged, Mitsuba refuses it, it has no perspective
            camera, none of that id or no light, the backend is not available, or thin glass is asked for and
            there is no pane.
    """
    select_backend(backend)
    from hybrid.preparation.scene_plan import as_stored
    from pathtrace.scene.scene import load_scene

    moves = None if motion is None else Path(motion)
    return as_stored(load_scene(source, max_depth, thin_glass, moves, sensor))


def plan(scene: Scene, *, progress: Progress = no_progress) -> Scene:
    """Plans a scene: looks at it and decides which paths, frames and Gaussians it requires.

    The plan is made if none is stored yet, which takes seconds to minutes, and stored in the cache folder, so
    that `load_scene` finds it. `hybrid plan` shows the decisions and changes them.

    Args:
        scene: the scene; a path depth that it was loaded with stays.
        progress: called with parts done, parts in total, and a label.

    Returns:
        The scene as planned; `plan` has the decisions by name. As it was if it cannot be looked at, because
        its camera sees no surface or stands in one, which is logged.

    Raises:
        UserError: the cache folder cannot be written, or the stored plan contradicts the scene.

    Examples:
        >>> scene = hybrid.plan(hybrid.load_scene("room"))
        >>> scene.plan["path depth"], scene.plan["gaussians"]
    """
    from hybrid.preparation.scene_plan import as_planned

    return as_planned(scene, bars_of(progress))


def capture(
    scene: Scene,
    folder: Path | str,
    settings: CaptureSettings | None = None,
    progress: Progress = no_progress,
    *,
    integrator: Integrator | str = "cached",
) -> FrameSet:
    """Renders a frame set for training; resumes if interrupted.

    Frames are of the scene as planned, and take down the plan for their training. It is made if there is
    none.

    Args:
        scene: what to render.
        folder: of the frame set; created if it does not exist.
        settings: what to capture; the defaults of CaptureSettings if None.
        progress: called with steps done, steps in total, and a label.
        integrator: of training frames; held-out frames are always unbiased.

    Raises:
        UserError: the integrator is unknown, the folder holds another capture or cannot be written, or
            the scene leaves no room for that many views.
    """
    from hybrid.base.cache_folder import keep_receipt
    from hybrid.preparation.scene_plan import as_planned
    from hybrid.render.irradiance import cache_for
    from pathtrace.dataset.capture import capture as run
    from pathtrace.dataset.frame_set import CaptureSettings

    bars, is_cached = bars_of(progress), integrator_named(integrator) is Integrator.CACHED
    scene = as_planned(scene, bars)
    cache = cache_for(scene, bars) if is_cached else None
    with bars("capture (samples)") as bar:
        frames = run(scene, Path(folder), settings or CaptureSettings(), bar, cache)
    keep_receipt(frames)
    return frames


def prepare(
    scene: Scene,
    settings: PreparationSettings | None = None,
    path: Path | str | None = None,
    *,
    progress: Progress = no_progress,
) -> Forest:
    """Captures and trains in turns, from nothing to a forest; resumes if interrupted.

    A plan is made first if the scene has none.

    Args:
        scene: what to prepare.
        settings: how far, and in which region; the defaults of PreparationSettings if None.
        path: forest file to write; the forest becomes the newest one of its scene in any case.
        progress: called with steps done, steps in total, and a label.

    Raises:
        UserError: the region has no free space, a target cannot be reached, or a file cannot be written.
    """
    from hybrid.preparation.preparation import prepare as run
    from hybrid.preparation.scene_plan import as_planned
    from splat.io.forest_file import save_forest

    bars = bars_of(progress)
    forest = run(as_planned(scene, bars), settings, bars).forest
    if path is not None:
        save_forest(Path(path), forest)
    return forest


def load_frames(folder: Path | str) -> Frames:
    """Loads a captured frame set, or a folder of third-party images with cameras and times.

    Raises:
        UserError: the folder is neither, incomplete or damaged.
    """
    from hybrid.preparation.training_views import read_frames

    return read_frames(Path(folder))


def train(
    frames: Frames,
    path: Path | str,
    settings: TrainingSettings | None = None,
    progress: Progress = no_progress,
) -> Forest:
    """Trains a forest on a frame set and writes it; resumes if interrupted.

    Args:
        frames: to train on.
        path: forest file to write.
        settings: how to train; as planned for the frames' scene if None.
        progress: called with steps done, steps in total, and a label.

    Raises:
        UserError: a frame is damaged, there are none to train on, or the file cannot be written.
    """
    select_backend()
    from hybrid.preparation.forest_training import train as run

    with bars_of(progress)("train (steps)") as bar:
        return run(frames, Path(path), settings, bar)


def load_forest(path: Path | str) -> Forest:
    """Loads a forest file.

    Raises:
        UserError: the file is missing, damaged, or of another version.
    """
    from splat.io.forest_file import load_forest as load

    return load(Path(path))


def evaluate(
    scene: Scene,
    forest: Forest,
    folder: Path | str,
    settings: EvaluationSettings | None = None,
    *,
    baseline_forest: Path | str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Compares hybrid frames with baselines at equal rays and at equal time; resumes if interrupted.

    Writes index.html (a page that requires no server), evaluation.json and all images. Metrics run in
    processes of their own: call it from a program under `if __name__ == "__main__":`.

    Args:
        scene, forest: what is rendered; a scene without a plan has the paths planned for the forest.
        folder: for the report; the evaluation resumes from what it finds there.
        settings: what to measure; the defaults of EvaluationSettings if None.
        baseline_forest: forest file of Gaussians without trees (trained with one layer) to compare with.
        progress: called with work done, work in total (of the whole evaluation, in thousandths of a view),
            and the current activity.

    Returns:
        The content of evaluation.json: scene, settings, display, views, references, methods, quality (rows of
        view, seed, method, budget, region, metric, value), time (rows of method, budget, ms, passes),
        verdicts (rows of region, metric, baseline, budget, difference, low, high, verdict), preparation (rows
        of method, seconds, frames_to_pay), machine.

    Raises:
        UserError: the settings cannot be measured, a forest belongs to another scene, or the folder holds
            another evaluation.
    """
    from hybrid.evaluation.evaluation import evaluation_of
    from hybrid.evaluation.evaluation_page import write_evaluation

    folder = Path(folder)
    flat = None if baseline_forest is None else Path(baseline_forest)
    evaluation = evaluation_of(scene, forest, settings, folder, flat)
    found = evaluation.run(
        lambda activity, done, total: progress(int(1000 * done), 1000 * int(total), activity)
    )
    write_evaluation(folder, found)
    return found
