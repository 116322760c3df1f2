"""Fits Gaussians to pictures of Gaussians, so that any view tells something, and no path is traced.

Other programs blend as 3D Gaussian splatting does. The same numbers look darker there at soft edges, and
wider by its larger filter: in `room` 31 dB from the forest's own picture. Once fitted it is 38 dB, and at
twice the resolution of the training 36.

Of a hierarchy, merged moments are a start; what a node should show also depends on what lies around it, and
on what of it fewer and larger Gaussians can show at all.
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
from splat.model.gaussians import Blending, Gaussians, concatenated, perceptual_from_radiance
from splat.model.hierarchy import Hierarchy
from splat.model.points import rows_of
from splat.raster.cut import HierarchyCut
from splat.raster.differentiable import render_differentiable, visible
from splat.raster.projection import PIXEL_FILTER
from splat.raster.tiles import TILE
from splat.training.gaussian_optimizer import GaussianOptimizer

# Least number of steps of a fit for display, and steps per view where there are many.
_STEPS, _PER_VIEW = 400, 4
# Side in pixels of the part of a view that a step looks at.
_SIDE = 256
# Standard deviation, in degrees, by which views are turned at random.
_TURN = 8.0
# Half of the views have the resolution of the training, the others up to so many octaves more.
_CLOSER = 1.5
# Positions move by a tenth of what they do in a training: Gaussians are where they belong.
_STILLNESS = 0.1
# Share of the steps, at the end, whose views tell how well others are shown.
_JUDGED = 0.1
# Number of views where none are known, and how far beyond the two Gaussians that they lie between.
_VIEWS, _BEYOND = 64, 0.25
# Cuts have this share of the leaves that a view shows, at least and at most, on a logarithmic scale.
_LEAST, _MOST = 1 / 40, 0.9
# Level in pixels that no node is smaller than, from which cuts are made coarser.
_FINEST = 0.05


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
        camera = _between(cameras, focal, np.random.default_rng([seed, step]))
        shown = visible(arrays, replace(optimizer.on_device, blending=Blending.DISPLAY), camera)
        if len(shown):
            with torch.no_grad():
                truth = _picture(arrays, own, camera, _low_pass(camera, focal))
            chosen = replace(optimizer.chosen(shown), blending=Blending.DISPLAY)
            image = _picture(arrays, chosen, camera, PIXEL_FILTER)
            # What is brighter than a display shows need not be as bright, but may.
            difference = torch.where(truth < 1, image, image.clamp(max=1)) - truth.clamp(max=1)
            optimizer.step(difference.abs().mean(), step / steps)
            if step >= (1 - _JUDGED) * steps:
                errors.append(float(difference.detach().clamp(max=1).square().mean()))
        progress(step + 1, steps)
    psnr = decibels(float(np.mean(errors))) if errors else np.inf
    return replace(optimizer.gaussians, blending=Blending.DISPLAY), psnr


def fitted_hierarchy(
    arrays: Arrays,
    hierarchy: Hierarchy,
    leaves: Gaussians,
    focal: float,
    cameras: Sequence[Camera],
    seed: int,
    steps: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Hierarchy, float, float]:
    """A hierarchy with inner nodes that are fitted, so that its cuts look as its leaves do.

    Args:
        leaves: N Gaussians, on the host.
        steps: how often a cut is looked at.
        focal, cameras, seed, progress: as for `fitted_for_display`.

    Returns:
        The hierarchy, and the PSNR in dB of its cuts to pictures of the leaves, before and after, in views
        that it was not fitted to yet. If it is no better than before, it stays as it was.
    """
    nodes = hierarchy.nodes(leaves)
    cut, own = HierarchyCut(arrays, nodes), leaves.to(arrays.device)
    inner = nodes.gaussians.part(len(leaves), len(nodes.gaussians))
    optimizer = GaussianOptimizer(inner, _STILLNESS * TYPICAL_DISTANCE / focal, arrays.device)
    merged, errors = inner.to(arrays.device), np.zeros((0, 2))
    for step in range(steps):
        rng = np.random.default_rng([seed, step])
        camera = _between(cameras, focal, rng)
        chosen = _cut_at_random(cut, camera, rng).to(arrays.device)
        few, many = chosen[chosen >= len(leaves)] - len(leaves), chosen[chosen < len(leaves)]
        if len(few):
            low_pass, finer = _low_pass(camera, focal), own.select(many)
            with torch.no_grad():
                truth = _picture(arrays, own, camera, low_pass)
            now = concatenated([finer, optimizer.chosen(few)])
            difference = _picture(arrays, now, camera, low_pass) - truth
            optimizer.step(difference.abs().mean(), step / steps)
            if step >= (1 - _JUDGED) * steps:
                with torch.no_grad():
                    before = concatenated([finer, merged.select(few)])
                    former = _picture(arrays, before, camera, low_pass) - truth
                both = [float(part.detach().clamp(-1, 1).square().mean()) for part in (former, difference)]
                errors = np.append(errors, [both], axis=0)
        progress(step + 1, steps)
    fitted = replace(optimizer.gaussians, blending=leaves.blending)
    first, last = map(float, errors.mean(axis=0)) if len(errors) else (0.0, 0.0)
    found = replace(hierarchy, inner=fitted) if last < first else hierarchy
    return found, decibels(first), decibels(min(first, last))


def _picture(arrays: Arrays, gaussians: Gaussians, camera: Camera, low_pass: float) -> torch.Tensor:
    return perceptual_from_radiance(render_differentiable(arrays, gaussians, camera, low_pass))


def _low_pass(camera: Camera, focal: float) -> float:
    """That of levels of detail, which are never drawn finer than the pixels that they were trained on."""
    return PIXEL_FILTER * max(1.0, camera.fy / focal) ** 2


def _cut_at_random(cut: HierarchyCut, camera: Camera, rng: np.random.Generator) -> torch.Tensor:
    corners = (-(-camera.height // TILE) + 1, -(-camera.width // TILE) + 1)
    levels = np.full(corners, _FINEST, dtype=np.float32)
    leaves = len(cut.nodes(camera, levels, 1.0)[0])
    most = round(leaves * float(np.exp(rng.uniform(np.log(_LEAST), np.log(_MOST)))))
    index, _ = cut.nodes(camera, levels * np.float32(cut.least_factor(camera, levels, most)), 1.0)
    return torch.from_numpy(np.sort(index.numpy().astype(np.int64)))


def _between(cameras: Sequence[Camera], focal: float, rng: np.random.Generator) -> Camera:
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
