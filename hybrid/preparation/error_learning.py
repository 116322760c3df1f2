"""Learns where a forest is wrong, from what it shows of the frames that it was trained on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.image.colour import Image, srgb_from_radiance
from hybrid.base.compute_device import device_arrays
from hybrid.preparation.training_views import Frames
from hybrid.render.forest_attachments import attach_errors
from pathtrace.dataset.captured_frames import read_radiance
from pathtrace.dataset.frame_set import FrameSet
from pathtrace.dataset.posed_images import read_pixels
from splat.lod.forest_renderer import ForestRenderer
from splat.model.forest import Forest
from splat.model.gaussians import Blending
from splat.raster.differentiable import contributions

# Frames that tell, at most, evenly spaced over all.
_TELLING = 24
# Pixels along the side of those over which errors are averaged: a few per cell of a frame.
_POOLED = 4
# Pixels that a node must cover for its own error to count as much as that of all.
_PRIOR = 1.0


def with_errors(frames: Frames, forest: Forest) -> Forest:
    """The forest with the squared error to expect where each node of its coarsest layer shows.

    It is the mean of the errors of the finest layer in frames, weighted by what the node contributes there.
    """
    arrays, coarse = device_arrays(), forest.coarsest_alone()
    renderer, count = ForestRenderer(arrays, forest), len(coarse.nodes)
    sums = torch.zeros(count, 2)
    for camera, time, radiance in _telling(frames):
        renderer.set_time(time)
        shown = np.array(renderer.render_layer(camera, len(forest.counts)).numpy())
        errors = np.square(srgb_from_radiance(shown) - srgb_from_radiance(radiance)).mean(axis=2)
        errors = np.nan_to_num(errors, nan=1.0)
        sums += _attributed(arrays, coarse, camera, time, errors.astype(np.float32))
    total, weight = sums.double().T
    mean = total.sum() / weight.sum().clamp(min=1e-9)
    return attach_errors(forest, ((total + _PRIOR * mean) / (weight + _PRIOR)).float())


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


def _attributed(arrays: Arrays, coarse: Forest, camera: Camera, time: float, errors: Image) -> torch.Tensor:
    """(N, 2) of nodes the sums, over pixels, of errors (H, W) times what they contribute, and of that."""
    height, width = (max(1, side // _POOLED) for side in errors.shape)
    pooled = torch.nn.functional.adaptive_avg_pool2d(torch.from_numpy(errors)[None], (height, width))[0]
    nodes = coarse.nodes
    shown = replace(nodes.gaussians, blending=Blending.LINEAR)
    if coarse.motion is not None:
        shown = coarse.motion.shown(shown, nodes.semantic, time)
    weights = np.stack([pooled.numpy(), np.ones_like(pooled.numpy())], axis=2)
    return contributions(arrays, shown, coarse.place.camera(camera.resized(width, height)), weights)
