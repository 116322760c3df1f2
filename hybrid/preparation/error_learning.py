"""Learns where a forest is wrong, from what it shows of the frames that it was trained on.

The errors of the finest layer in these frames are images, which the nodes of the coarsest layer are to show
as if they were radiance. That is solved as astronomers sharpen images (Richardson 1972, Lucy 1974): each node
is corrected by the mean ratio of the errors that were found to those that it and others show.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image, srgb_from_radiance
from hybrid.base.compute_device import device_arrays
from hybrid.preparation.training_views import Frames
from hybrid.render.expected_errors import errors_in, harmonics_of
from hybrid.render.forest_attachments import attach_errors
from pathtrace.dataset.captured_frames import read_radiance
from pathtrace.dataset.frame_set import FrameSet
from pathtrace.dataset.posed_images import read_pixels
from splat.lod.forest_renderer import ForestRenderer
from splat.model.forest import Forest
from splat.model.gaussians import Blending, Gaussians
from splat.raster.differentiable import contributions, render_differentiable

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
    renderer = ForestRenderer(arrays, forest)
    views = []
    for camera, time, radiance in _telling(frames):
        renderer.set_time(time)
        shown = np.array(renderer.render_layer(camera, len(forest.counts)).numpy())
        errors = np.square(srgb_from_radiance(shown) - srgb_from_radiance(radiance)).mean(axis=2)
        pooled = _pooled(np.nan_to_num(errors, nan=1.0).astype(np.float32))
        small = camera.resized(pooled.shape[1], pooled.shape[0])
        views.append((coarse.place.camera(small), _at(coarse, time), pooled))
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


def _pooled(errors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Errors (H, W), averaged over _POOLED x _POOLED pixels."""
    height, width = (max(1, side // _POOLED) for side in errors.shape)
    size = height, width
    return torch.nn.functional.adaptive_avg_pool2d(torch.from_numpy(errors)[None], size)[0].numpy()


def _at(coarse: Forest, time: float) -> Gaussians:
    """The nodes of a forest's only layer at a time, to show errors."""
    shown = replace(coarse.nodes.gaussians, directional=None, blending=Blending.LINEAR)
    if coarse.motion is None:
        return shown
    with torch.no_grad():
        return coarse.motion.shown(shown, coarse.nodes.semantic, time)


def _telling(frames: Frames) -> Iterator[tuple[Camera, float, Image]]:
    """Cameras, times and radiance (H, W, 3) of some frames."""
    entries: Sequence[Any] = frames.training
    for number in sorted({round(at) for at in np.linspace(0, len(entries) - 1, _TELLING)}):
        entry = entries[number]
        if isinstance(frames, FrameSet):
            yield entry.camera, entry.time, read_radiance(entry.file, entry.size)
        else:
            pixels = read_pixels(entry)
            yield pixels.camera, entry.time, pixels.radiance
