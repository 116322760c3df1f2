"""Fits Gaussians that are blended linearly to look alike where display-encoded values are blended.

Other programs blend as 3D Gaussian splatting does. The same numbers look darker there at soft edges, and
wider by its larger filter: in `room` 31 dB from the forest's own picture. Once fitted it is 38 dB, and at
twice the resolution of the training 36. The truth is that picture, so that any view tells something.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from compose.base.arrays import Arrays
from compose.camera.camera import Camera, camera_from_pose, look_at, turned
from compose.camera.coordinate_systems import TYPICAL_DISTANCE
from compose.image.colour import decibels
from splat.model.gaussians import Blending, Gaussians, perceptual_from_radiance
from splat.model.points import rows_of
from splat.raster.differentiable import render_differentiable, visible
from splat.raster.projection import PIXEL_FILTER
from splat.training.gaussian_optimizer import GaussianOptimizer

# Least number of steps, and steps per view where there are many.
_STEPS, _PER_VIEW = 400, 4
# Side in pixels of the part of a view that a step looks at.
_SIDE = 256
# Standard deviation, in degrees, by which views are turned at random.
_TURN = 8.0
# Half of the views have the resolution of the training, the others up to so many octaves more: other programs
# have larger windows.
_CLOSER = 1.5
# Positions move by a tenth of what they do in a training: Gaussians are where they belong.
_STILLNESS = 0.1
# Share of the steps, at the end, whose views tell how well others are shown.
_JUDGED = 0.1
# Number of views where none are known, and how far beyond the two Gaussians that they lie between.
_VIEWS, _BEYOND = 64, 0.25


def fitted_for_display(
    arrays: Arrays,
    gaussians: Gaussians,
    focal: float,
    cameras: Sequence[Camera],
    seed: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Gaussians, float]:
    """Gaussians for the rules of 3D Gaussian splatting that look as those given, which are blended linearly.

    Args:
        gaussians: N, on the host.
        focal: vertical focal length in pixels of the frames that they were trained on.
        cameras: views of any size, in the coordinates of the Gaussians; at least one.
        seed: which views between these are looked at.
        progress: is told steps done, and all.

    Returns:
        The Gaussians, in the same order, and the PSNR in dB of display-encoded pictures of them to those of
        the ones given, in views that they were not fitted to yet.
    """
    own = gaussians.to(arrays.device)
    optimizer = GaussianOptimizer(gaussians, _STILLNESS * TYPICAL_DISTANCE / focal, arrays.device)
    steps, errors = max(_STEPS, _PER_VIEW * len(cameras)), []
    for step in range(steps):
        camera = between(cameras, focal, np.random.default_rng([seed, step]))
        shown = visible(arrays, replace(optimizer.on_device, blending=Blending.DISPLAY), camera)
        if len(shown):
            # As levels of detail are drawn: never finer than the pixels that they were trained on.
            low_pass = PIXEL_FILTER * max(1.0, camera.fy / focal) ** 2
            with torch.no_grad():
                truth = perceptual_from_radiance(render_differentiable(arrays, own, camera, low_pass))
            chosen = replace(optimizer.chosen(shown), blending=Blending.DISPLAY)
            image = perceptual_from_radiance(render_differentiable(arrays, chosen, camera))
            # What is brighter than a display shows need not be as bright, but may.
            difference = torch.where(truth < 1, image, image.clamp(max=1)) - truth.clamp(max=1)
            optimizer.step(difference.abs().mean(), step / steps)
            if step >= (1 - _JUDGED) * steps:
                errors.append(float(difference.detach().clamp(max=1).square().mean()))
        progress(step + 1, steps)
    psnr = decibels(float(np.mean(errors))) if errors else np.inf
    return replace(optimizer.gaussians, blending=Blending.DISPLAY), psnr


def between(cameras: Sequence[Camera], focal: float, rng: np.random.Generator) -> Camera:
    """A part of a view between one of the cameras and another one, turned a little."""
    first, second = (cameras[index] for index in rng.integers(0, len(cameras), 2))
    pose, share = first.camera_to_world, rng.uniform(0, 0.5)
    pose[:3, 3] = (1 - share) * first.position + share * second.position
    pose[:3, :3] = turned(pose[:3, :3], *(_TURN * rng.normal(size=2)))
    times = focal / first.fy * max(1.0, 2 ** rng.uniform(-_CLOSER, _CLOSER))
    camera = first.at(pose).resized(*(max(1, round(times * side)) for side in (first.width, first.height)))
    left, top = (int(rng.integers(0, max(0, side - _SIDE) + 1)) for side in (camera.width, camera.height))
    return camera.cropped(left, top, min(_SIDE, camera.width), min(_SIDE, camera.height))


def views_around(gaussians: Gaussians, focal: float, seed: int) -> list[Camera]:
    """Views of Gaussians of which none are known: from amid them and around, towards some of them."""
    means, rng, cameras = rows_of(gaussians.means), np.random.default_rng(seed), []
    for _ in range(_VIEWS):
        first, second, target = means[rng.integers(0, len(means), 3)]
        # Never at the target itself.
        eye = first + rng.uniform(-_BEYOND, 1 + _BEYOND) * (second - first) + 1e-3 * rng.normal(size=3)
        pose = look_at(eye, target, rng.normal(size=3))
        cameras.append(camera_from_pose(pose, _SIDE, _SIDE, focal, focal, _SIDE / 2, _SIDE / 2))
    return cameras
