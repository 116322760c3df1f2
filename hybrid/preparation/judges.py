"""Held-out views that judge a forest while it is prepared."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from compose.camera.camera import Camera
from hybrid.measure.metrics.similarity import quality
from hybrid.runtime.device import device_arrays
from pathtrace.dataset.exr import is_intact, read_frame, write_frame
from pathtrace.dataset.rendering import render_frame
from pathtrace.trace.tracer import Tracer
from splat.lod.renderer import ForestRenderer
from splat.model.forest import Forest

# Samples per pixel of their frames, which are denoised, like those that are trained on: several times as many
# as any of these have.
_SPP = 128
# Far from the seeds of training frames.
_SEED = 777_767_777


class Judges:
    """Frames of views that nothing is trained on; rendered once, and kept in a folder.

    They are traced as the training frames are, which may be biased by up to a percent: their error is that of
    the Gaussians against what these could learn.

    Args:
        folder: for their files.
        tracer: traces the scene.
        cameras: the views.
        times: that they show.
        progress: called with frames done and frames in total.

    Raises:
        UserError: a file cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        tracer: Tracer,
        cameras: list[Camera],
        times: list[float],
        progress: Callable[[int, int], None],
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
        if not found:
            return {}
        mean = {name: float(np.mean([row[name] for row in found])) for name in ("psnr", "ssim")}
        return {**mean, "least_psnr": min(row["psnr"] for row in found)}
