"""Quality of a forest in views that it was not trained on: after a training, and while it is prepared."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compose.camera.camera import Camera
from hybrid.base.compute_device import device_arrays
from hybrid.base.progress import Steps
from hybrid.measure.image_metrics import quality
from hybrid.preparation.training_views import Frames, posed_view, training_view
from pathtrace.dataset.captured_frames import is_intact, read_frame, render_frame, write_frame
from pathtrace.dataset.frame_set import FrameSet
from pathtrace.trace.tracer import Tracer
from splat.lod.forest_renderer import ForestRenderer
from splat.model.forest import Forest
from splat.training.training_view import reduced


def held_out_quality(frames: Frames, forest: Forest) -> list[dict[str, Any]]:
    """Mean PSNR and SSIM of each layer alone over the held-out views, coarsest first.

    Layer l is compared with frames that are reduced to its resolution. Frames with numbers that are not
    finite are left out. Rows have layer (1 to L), nodes and, with held-out views, psnr in dB and ssim.
    """
    renderer = ForestRenderer(device_arrays(), forest)
    if isinstance(frames, FrameSet):
        # A frame that is not finite tells nothing: its PSNR would be NaN, and the mean as well.
        captured = (training_view(entry, frames.courses) for entry in frames.held_out)
        views = [view for view in captured if view.is_finite]
    else:
        views = [posed_view(image) for image in frames.held_out]
    rows: list[dict[str, Any]] = []
    for number, count in enumerate(forest.counts, start=1):
        factor = 2 ** (len(forest.counts) - number)
        found = []
        for view in (reduced(view, factor) for view in views):
            renderer.set_time(view.time)
            found.append(quality(renderer.render_layer(view.camera, number).numpy(), view.radiance))
        rows.append({"layer": number, "nodes": count, **_means(found)})
    return rows


def _means(rows: list[dict[str, float]]) -> dict[str, float]:
    """Means by name over rows; empty if there are none."""
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]} if rows else {}


# Samples per pixel of their frames, which are denoised, like those that are trained on: several times as many
# as any of these have.
_SPP = 128
# Far from the seeds of training frames.
_SEED = 777_767_777


class Judges:
    """Frames of views that nothing is trained on; rendered once, and kept in a folder.

    They are traced as the training frames are, which may be biased by up to a percent: their error is that of
    the Gaussians against what these could learn. `progress` is called with frames done and frames in total.

    Raises:
        UserError: a file cannot be written.
    """

    def __init__(
        self, folder: Path, tracer: Tracer, cameras: list[Camera], times: list[float], progress: Steps
    ):
        self._cameras, self._times = cameras, times
        self._files = [folder / f"{n:04d}.exr" for n in range(len(cameras))]
        folder.mkdir(parents=True, exist_ok=True)
        for number, (camera, file) in enumerate(zip(cameras, self._files, strict=True)):
            if not is_intact(read_frame, file, camera):
                tracer.scene.show(times[number])
                write_frame(file, render_frame(tracer, camera, _SPP, _SEED + number))
            progress(number + 1, len(cameras))

    def quality(self, forest: Forest) -> dict[str, float]:
        """psnr in dB and ssim of the finest layer, means over the views, and least_psnr; empty without."""
        renderer, found = ForestRenderer(device_arrays(), forest), []
        for camera, time, file in zip(self._cameras, self._times, self._files, strict=True):
            renderer.set_time(time)
            truth = read_frame(file, (camera.width, camera.height)).radiance
            if np.isfinite(truth).all():
                found.append(quality(renderer.render_layer(camera, len(forest.counts)).numpy(), truth))
        return _means(found) | ({"least_psnr": min(row["psnr"] for row in found)} if found else {})
