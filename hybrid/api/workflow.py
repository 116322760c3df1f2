"""Loads scenes, frame sets and forests; captures frame sets and trains forests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid.base.progress import no_progress
from pathtrace.scene.backend import select_backend

if TYPE_CHECKING:
    from hybrid.preparation.stages import PreparationSettings
    from hybrid.preparation.training_views import Frames
    from pathtrace.dataset.frame_set import CaptureSettings, FrameSet
    from pathtrace.scene.scene import Scene
    from pathtrace.trace.integrator import Integrator
    from splat.model.forest import Forest
    from splat.training.trainer import TrainingSettings

Progress = Callable[[int, int], None]


def load_scene(
    source: str | Path | dict[str, Any],
    *,
    max_depth: int | None = None,
    thin_glass: bool = False,
    backend: str = "auto",
) -> Scene:
    """Loads a scene with the paths that are planned for it. The first call also selects the backend.

    The plan is made in seconds when a scene is loaded for the first time, and stored in the cache folder.

    Args:
        source: name of a bundled scene, path of a Mitsuba 3 XML file, or scene dictionary.
        max_depth: path depth; as planned if None.
        thin_glass: whether panes of glass let shadow rays pass; such a scene has a hash of its own.
        backend: auto (CUDA if available), cuda or llvm; it cannot change within a process.

    Raises:
        UserError: the scene is missing, Mitsuba refuses it, it has no perspective camera or no light, the
            backend is not available, or thin glass is asked for and there is no pane.
    """
    select_backend(backend)
    from hybrid.preparation.scene_plan import planned_scene

    return planned_scene(source, max_depth, thin_glass)


def capture(
    scene: Scene,
    folder: Path | str,
    settings: CaptureSettings | None = None,
    progress: Progress = no_progress,
    *,
    integrator: Integrator | str = "cached",
) -> FrameSet:
    """Renders a frame set for training; resumes if interrupted.

    Args:
        scene: what to render.
        folder: of the frame set; created if it does not exist.
        settings: what to capture; the defaults of CaptureSettings if None.
        progress: called with samples done and samples in total.
        integrator: of training frames; held-out frames are always unbiased.

    Raises:
        UserError: the integrator is unknown, the folder holds another capture or cannot be written, or
            the scene leaves no room for that many views.
    """
    from hybrid.base.cache_folder import keep_receipt
    from hybrid.render.irradiance import cache_for
    from pathtrace.dataset.capture import capture as run
    from pathtrace.dataset.frame_set import CaptureSettings
    from pathtrace.trace.integrator import Integrator, integrator_named

    cache = cache_for(scene) if integrator_named(integrator) is Integrator.CACHED else None
    frames = run(scene, Path(folder), settings or CaptureSettings(), progress, cache)
    keep_receipt(frames)
    return frames


def prepare(
    scene: Scene, settings: PreparationSettings | None = None, path: Path | str | None = None
) -> Forest:
    """Captures and trains in turns, from nothing to a forest, without telling how far it is.

    Args:
        scene: what to prepare.
        settings: how far, and in which region; the defaults of PreparationSettings if None.
        path: forest file to write; the forest becomes the newest one of its scene in any case.

    Raises:
        UserError: the region has no free space, a target cannot be reached, or a file cannot be written.
    """
    from hybrid.base.progress import no_bars
    from hybrid.preparation.preparation import prepare as run
    from splat.io.forest_file import save_forest

    forest = run(scene, settings, no_bars).forest
    if path is not None:
        save_forest(Path(path), forest)
    return forest


def load_frames(folder: Path | str) -> Frames:
    """Loads a captured frame set, or a folder of other people's images with cameras and times.

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
        settings: how to train; the defaults of TrainingSettings if None.
        progress: called with steps done and steps in total.

    Raises:
        UserError: a frame is damaged, there are none to train on, or the file cannot be written.
    """
    select_backend()
    from hybrid.preparation.forest_training import train as run

    return run(frames, Path(path), settings, progress)


def load_forest(path: Path | str) -> Forest:
    """Loads a forest file.

    Raises:
        UserError: the file is missing, damaged, or of another version.
    """
    from splat.io.forest_file import load_forest as load

    return load(Path(path))
