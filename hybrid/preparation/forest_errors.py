"""Where a forest is wrong: its quality in views that it was not trained on, and what its nodes learn of it.

The errors of the finest layer in training frames are images, which the nodes of the coarsest layer are to
show as if they were radiance. That is solved as astronomers sharpen images (Richardson 1972, Lucy 1974): each
node is corrected by the mean ratio of the errors that were found to those that it and others show.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from compose.camera.camera import Camera
from compose.image.colour import Image, srgb_from_radiance
from hybrid.base.compute_device import device_arrays
from hybrid.base.progress import Steps
from hybrid.measure.image_metrics import quality
from hybrid.preparation.training_views import Frames, posed_view, training_view
from hybrid.render.expected_errors import errors_in, harmonics_of
from hybrid.render.forest_attachments import attach_errors
from pathtrace.dataset.captured_frames import is_intact, read_frame, read_radiance, render_frame, write_frame
from pathtrace.dataset.frame_set import FrameSet
from pathtrace.dataset.posed_images import PosedImage, read_pixels
from pathtrace.trace.tracer import Tracer
from splat.lod.forest_renderer import ForestRenderer
from splat.model.forest import Forest
from splat.model.gaussians import Blending, Gaussians
from splat.raster.differentiable import contributions, render_differentiable
from splat.training.training_view import reduced


def finest_shown(forest: Forest) -> Callable[[Camera, float], Image]:
    """What the finest layer of a forest shows to a camera at a time, (H, W, 3)."""
    renderer = ForestRenderer(device_arrays(), forest)

    def show(camera: Camera, time: float) -> Image:
        renderer.set_time(time)
        return np.array(renderer.render_layer(camera, len(forest.counts)).numpy())

    return show


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
HELD_OUT_SPP = 128
# Far from the seeds of training frames.
_SEED = 777_767_777


class Judges:
    """Frames of views that nothing is trained on; rendered once, and kept in a folder.

    They are traced as the training frames are, which may be biased by up to a percent: their error is that of
    the Gaussians against what these could learn. `progress` is called with frames done and frames in total.
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
                write_frame(file, render_frame(tracer, camera, HELD_OUT_SPP, _SEED + number))
            progress(number + 1, len(cameras))

    def quality(self, forest: Forest) -> dict[str, float]:
        """psnr in dB and ssim of the finest layer, means over the views, and least_psnr; empty without."""
        show, found = finest_shown(forest), []
        for camera, time, file in zip(self._cameras, self._times, self._files, strict=True):
            truth = read_frame(file, (camera.width, camera.height)).radiance
            if np.isfinite(truth).all():
                found.append(quality(show(camera, time), truth))
        return _means(found) | ({"least_psnr": min(row["psnr"] for row in found)} if found else {})


# Frames that tell, at most, evenly spaced over all; and corrections. The first one gives each node the mean
# of the errors where it shows, up to four times too small where they are great.
_TELLING, _CORRECTIONS = 16, 4
# Pixels along the side of those over which errors are averaged: a few per cell of a frame.
_POOLED = 4
# Pixels that a node must cover for what is found there to count as much as what is known.
_PRIOR = 1.0
# Least error that counts as one.
_LEAST = 1e-7


def with_errors(frames: Frames, forest: Forest) -> Forest:
    """The forest with the squared error to expect where each node of its coarsest layer shows."""
    arrays, coarse = device_arrays(), forest.coarsest_alone()
    show, views = finest_shown(forest), []
    for camera, time, radiance in _telling(frames):
        difference = srgb_from_radiance(show(camera, time)) - srgb_from_radiance(radiance)
        errors = np.square(difference).mean(axis=2)
        known = torch.from_numpy(np.nan_to_num(errors, nan=1.0).astype(np.float32))
        height, width = (max(1, side // _POOLED) for side in errors.shape)
        pooled = torch.nn.functional.adaptive_avg_pool2d(known[None], (height, width))[0].numpy()
        place = coarse.place.camera(camera.resized(width, height))
        views.append((place, _at(coarse, time), pooled))
    mean = float(np.mean([pooled.mean() for _, _, pooled in views]))
    found = torch.full((len(coarse.nodes),), max(mean, _LEAST))
    for _ in range(_CORRECTIONS):
        sums, sh = torch.zeros(len(found), 2), harmonics_of(found)
        for camera, nodes, pooled in views:
            with torch.no_grad():
                expected = errors_in(render_differentiable(arrays, replace(nodes, sh=sh), camera).numpy())
            ratio = pooled / np.maximum(expected, _LEAST)
            sums += contributions(arrays, nodes, camera, np.stack([ratio, np.ones_like(ratio)], axis=2))
        found = found * (sums[:, 0] + _PRIOR) / (sums[:, 1] + _PRIOR)
    return attach_errors(forest, found)


def _at(coarse: Forest, time: float) -> Gaussians:
    """The nodes of a forest's only layer at a time, to show errors."""
    shown = replace(coarse.nodes.gaussians, directional=None, blending=Blending.LINEAR)
    if coarse.motion is None:
        return shown
    with torch.no_grad():
        return coarse.motion.shown(shown, coarse.nodes.semantic, time)


def _telling(frames: Frames) -> Iterator[tuple[Camera, float, Image]]:
    """Cameras, times and radiance (H, W, 3) of some frames."""
    for number in sorted({round(at) for at in np.linspace(0, len(frames.training) - 1, _TELLING)}):
        entry = frames.training[number]
        if isinstance(entry, PosedImage):
            pixels = read_pixels(entry)
            yield pixels.camera, entry.time, pixels.radiance
        else:
            yield entry.camera, entry.time, read_radiance(entry.file, entry.size)
