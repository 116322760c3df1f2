"""Captures a frame set: views chosen in free space, traced, denoised, written one by one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from compose.camera.camera import Camera
from compose.camera.serialization import camera_from_json
from pathtrace.cache.cache import IrradianceCache
from pathtrace.dataset.exr import (
    is_intact,
    read_estimate,
    read_frame,
    read_radiance,
    write_estimate,
    write_frame,
    write_radiance,
)
from pathtrace.dataset.frames import FrameSet, read_frame_set
from pathtrace.dataset.rendering import render_estimates, render_frame, render_with_halves
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.dataset.transforms import describe_capture, write_description
from pathtrace.dataset.views import choose_views, monocular_views
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces
from pathtrace.trace.integrator import Integrator
from pathtrace.trace.tracer import Tracer

# Keeps the seeds of different captures apart: far more than one capture has frames.
_CAPTURE_SEED_STEP = 100_003


def capture(
    scene: Scene,
    folder: Path,
    settings: CaptureSettings,
    progress: Callable[[int, int], None],
    cache: IrradianceCache | None = None,
) -> FrameSet:
    """Captures a frame set of a scene to train on; resumes if it was interrupted.

    Views lie in free space around the scene's own camera, which is the first of them. The held-out ones are
    spaced evenly over the others. Two of three held-out views also have estimates, traced with fewer samples,
    two independent halves of their own samples, and close-ups at two and four times the resolution: what the
    fusion is fitted to. Held-out frames are unbiased; close-ups, which measure nothing else, need not be. Of
    a scene that moves, views have times of their own, which the scene shows one after another; a monocular
    capture is that of one camera, which sways around the scene's own.

    The folder gets a `transforms.json` in the Nerfstudio / instant-ngp convention and one multi-channel
    OpenEXR file per frame, estimate and close-up. Files are written atomically, and those that exist and are
    intact are not rendered again; a resumed capture ends with exactly the same files as one that was not
    interrupted.

    Args:
        scene: the scene, loaded for the selected Mitsuba variant.
        folder: the folder of the frame set; created if it does not exist.
        settings: number, size and sample counts of the frames, and the seed.
        progress: called after each frame with the number of samples done and their total.
        cache: irradiance of the scene in which the paths of training frames, estimates and close-ups end;
            without it, these are unbiased as well.

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
    # The free space is that of the beginning, whatever the scene has shown last.
    scene.show(0.0)
    size, surfaces = (settings.width, settings.height), Surfaces(scene)
    if settings.monocular:
        views = monocular_views(scene, surfaces, count, *size)
    else:
        views = choose_views(scene, surfaces, count, *size, settings.seed)
    integrator = Integrator.PATH if cache is None else Integrator.CACHED
    document = describe_capture(scene, views, settings, integrator)
    write_description(folder, document)
    unbiased, quick = Tracer(scene), Tracer(scene, cache=cache)
    entries = document["frames"] + document["close_ups"]
    cameras = [camera_from_json({**document, **entry}) for entry in entries]
    samples = [_samples(entry, camera) for entry, camera in zip(entries, cameras, strict=True)]
    tracers = [unbiased if entry["held_out"] else quick for entry in document["frames"]]
    tracers += [quick] * len(document["close_ups"])
    for index, (entry, camera) in enumerate(zip(entries, cameras, strict=True)):
        # Each frame has a seed of its own, so that a resumed capture ends with the same frames.
        seed = settings.seed * _CAPTURE_SEED_STEP + index
        scene.show(entry["time"])
        _write_estimates(quick, folder, entry, camera, seed)
        _write_frame(tracers[index], folder, entry, camera, seed)
        progress(sum(samples[: index + 1]), sum(samples))
    return read_frame_set(folder)


def _samples(entry: dict[str, Any], camera: Camera) -> int:
    """Samples of a view's frame and of its estimates."""
    per_pixel = entry["samples"] + sum(estimate["samples"] for estimate in entry["estimates"])
    return int(per_pixel * camera.width * camera.height)


def _write_estimates(tracer: Tracer, folder: Path, entry: dict[str, Any], camera: Camera, seed: int) -> None:
    """Renders and writes those estimates of one view that are not there, or damaged."""
    files = {e["samples"]: folder / e["file_path"] for e in entry["estimates"]}
    lacking = {spp: file for spp, file in files.items() if not is_intact(read_estimate, file, camera)}
    estimates = render_estimates(tracer, camera, tuple(files), seed, lacking)
    for file, estimate in zip(lacking.values(), estimates, strict=True):
        write_estimate(file, estimate)


def _write_frame(tracer: Tracer, folder: Path, entry: dict[str, Any], camera: Camera, seed: int) -> None:
    """Renders one view and writes what of it and its halves is not there, or damaged."""
    file, halves = folder / entry["file_path"], [folder / name for name in entry["halves"]]
    lacking = [half for half in halves if not is_intact(read_radiance, half, camera)]
    has_frame = is_intact(read_frame, file, camera)
    if has_frame and not lacking:
        return
    if halves:
        frame, radiances = render_with_halves(tracer, camera, entry["samples"], seed)
        for half, radiance in zip(halves, radiances, strict=True):
            if half in lacking:
                write_radiance(half, radiance)
    else:
        frame = render_frame(tracer, camera, entry["samples"], seed)
    if not has_frame:
        write_frame(file, frame)
