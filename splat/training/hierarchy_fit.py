"""Fits the inner nodes of a hierarchy, so that its cuts look as its leaves do.

Merged moments are a start; what a node should show also depends on what lies around it, and on what of it
fewer and larger Gaussians can show at all. The truth are pictures of the leaves, so that any view tells
something, and no path is traced.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.camera.coordinate_systems import TYPICAL_DISTANCE
from compose.image.colour import decibels
from splat.model.gaussians import Gaussians, concatenated, perceptual_from_radiance
from splat.model.hierarchy import Hierarchy
from splat.raster.cut import HierarchyCut
from splat.raster.differentiable import render_differentiable
from splat.raster.projection import PIXEL_FILTER
from splat.raster.tiles import TILE
from splat.training.display_fit import between
from splat.training.gaussian_optimizer import GaussianOptimizer

# Cuts have this share of the leaves that a view shows, at least and at most, on a logarithmic scale.
_LEAST, _MOST = 1 / 40, 0.9
# Level in pixels that no node is smaller than, from which cuts are made coarser.
_FINEST = 0.05
# Positions move by so much of what they do in a training.
_STILLNESS = 0.1
# Share of the steps, at the end, whose views tell how well others are shown.
_JUDGED = 0.1


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
    """A hierarchy with inner nodes that are fitted.

    Args:
        leaves: N Gaussians, on the host.
        focal: vertical focal length in pixels of the frames that they were trained on.
        cameras: views of any size, in the coordinates of the Gaussians; at least one.
        seed: which views between these are looked at, and which cuts.
        steps: how often.
        progress: is told steps done, and all.

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
        camera = between(cameras, focal, rng)
        chosen = _cut_at_random(cut, camera, rng)
        few, many = chosen[chosen >= len(leaves)] - len(leaves), chosen[chosen < len(leaves)]
        if len(few):
            few, many = few.to(arrays.device), many.to(arrays.device)
            low_pass, finer = PIXEL_FILTER * max(1.0, camera.fy / focal) ** 2, own.select(many)
            picture = lambda g: perceptual_from_radiance(  # noqa: E731
                render_differentiable(arrays, g, camera, low_pass)  # noqa: B023
            )
            with torch.no_grad():
                truth = picture(own)
            difference = picture(concatenated([finer, optimizer.chosen(few)])) - truth
            optimizer.step(difference.abs().mean(), step / steps)
            if step >= (1 - _JUDGED) * steps:
                with torch.no_grad():
                    former = picture(concatenated([finer, merged.select(few)])) - truth
                both = [part.detach().clamp(-1, 1).square().mean() for part in (former, difference)]
                errors = np.append(errors, [list(map(float, both))], axis=0)
        progress(step + 1, steps)
    fitted = replace(optimizer.gaussians, blending=leaves.blending)
    before, after = map(float, errors.mean(axis=0)) if len(errors) else (0.0, 0.0)
    found = replace(hierarchy, inner=fitted) if after < before else hierarchy
    return found, decibels(before), decibels(min(before, after))


def _cut_at_random(cut: HierarchyCut, camera: Camera, rng: np.random.Generator) -> torch.Tensor:
    """Numbers (K,) of the nodes of one cut, in ascending order."""
    corners = (-(-camera.height // TILE) + 1, -(-camera.width // TILE) + 1)
    levels = np.full(corners, _FINEST, dtype=np.float32)
    leaves = len(cut.nodes(camera, levels, 1.0)[0])
    most = round(leaves * float(np.exp(rng.uniform(np.log(_LEAST), np.log(_MOST)))))
    index, _ = cut.nodes(camera, levels * np.float32(cut.least_factor(camera, levels, most)), 1.0)
    return torch.from_numpy(np.sort(index.numpy().astype(np.int64)))
