"""Captures a frame set: views chosen in free space, traced, denoised, written one by one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from compose.camera.serialization import camera_from_json
from pathtrace.dataset.exr import write_estimate, write_frame
from pathtrace.dataset.frames import FrameSet, read_frame_set
from pathtrace.dataset.rendering import render_with_estimates
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.dataset.transforms import describe_capture, write_description
from pathtrace.dataset.views import choose_views
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces
from pathtrace.trace.tracer import Tracer

# Keeps the seeds of different captures apart: far more than one capture has frames.
_CAPTURE_SEED_STEP = 100_003


def capture(
    scene: Scene, folder: Path, settings: CaptureSettings, progress: Callable[[int, int], None]
) -> FrameSet:
    """Captures a frame set of a scene to train on; resumes if it was interrupted.

    Views lie in free space around the scene's own camera, which is the first of them. The held-out ones are
    spaced evenly over the others. Two of three held-out views also have estimates, traced with fewer samples,
    and close-ups at two and four times the resolution, to which the fusion is fitted.

    The folder gets a `transforms.json` in the Nerfstudio / instant-ngp convention and one multi-channel
    OpenEXR file per frame, estimate and close-up. Files are written atomically, and frames that exist are not
    rendered again; a resumed capture ends with exactly the same files as one that was not interrupted.

    Args:
        scene: the scene, loaded for the selected Mitsuba variant.
        folder: the folder of the frame set; created if it does not exist.
        settings: number, size and sample counts of the frames, and the seed.
        progress: called after each frame with the number of samples done and their total.

    Returns:
        The complete frame set.

    Raises:
        UserError: the folder holds another capture or cannot be written; the scene's own camera sees no
            surface; there is no free space for that many views; or more views are held out than may be.

    Example:
        >>> settings = CaptureSettings(views=40, held_out=4, spp=16, held_out_spp=64)
        >>> frames = capture(load_scene("room"), Path("frames"), settings, lambda done, total: None)
        >>> len(frames.training), len(frames.held_out)
        (40, 4)
    """
    count = settings.views + settings.held_out
    views = choose_views(scene, Surfaces(scene), count, settings.width, settings.height, settings.seed)
    document = describe_capture(scene, views, settings)
    write_description(folder, document)
    tracer = Tracer(scene)
    entries = document["frames"] + document["close_ups"]
    cameras = [camera_from_json({**document, **entry}) for entry in entries]
    samples = [
        entry["samples"] * camera.width * camera.height
        for entry, camera in zip(entries, cameras, strict=True)
    ]
    for index, (entry, camera) in enumerate(zip(entries, cameras, strict=True)):
        path = folder / entry["file_path"]
        if not path.is_file():
            # Each frame has a seed of its own, so that a resumed capture ends with the same frames.
            seed = settings.seed * _CAPTURE_SEED_STEP + index
            files = {e["samples"]: folder / e["file_path"] for e in entry["estimates"]}
            frame, estimates = render_with_estimates(tracer, camera, entry["samples"], seed, tuple(files))
            for file, estimate in zip(files.values(), estimates, strict=True):
                write_estimate(file, estimate)
            # Last: a frame that exists has all its estimates.
            write_frame(path, frame)
        progress(sum(samples[: index + 1]), sum(samples))
    return read_frame_set(folder)
