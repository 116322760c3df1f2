"""Gaussians in other coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from compose.camera.place import WORLD, Place, place_around
from splat.model.gaussians import Gaussians
from splat.model.rows import means_of

# Sizes of sets of Gaussians, in world space, that float32 and the rasterizer's near plane are made for, and
# how many sizes away from the world's origin they may lie.
_LEAST, _LARGEST, _FARTHEST = 0.1, 1e5, 1e3


def in_world(own: Gaussians, place: Place) -> Gaussians:
    """Gaussians of a place in world space: as exact as float32 is there."""
    return _mapped(own, np.array(place.origin), place.unit)


def from_world(world: Gaussians, place: Place) -> Gaussians:
    """Gaussians of the world in the coordinates of a place."""
    return _mapped(world, -np.array(place.origin) / place.unit, 1 / place.unit)


def place_of_gaussians(world: Gaussians) -> Place:
    """The place for Gaussians of which no views are known; the world itself where that is good enough."""
    means = means_of(world)
    middle = np.median(means, axis=0)
    size = float(np.median(np.linalg.norm(means - middle, axis=1)))
    near = np.linalg.norm(middle) <= _FARTHEST * size
    # A single Gaussian, or many in one point, have no size.
    return WORLD if size == 0 or (near and _LEAST <= size <= _LARGEST) else place_around(means, size)


def _mapped(gaussians: Gaussians, offset: NDArray[np.float64], scale: float) -> Gaussians:
    """The Gaussians scaled, then moved; computed in float64, and differentiable."""
    means = gaussians.means.double() * scale + torch.from_numpy(offset).to(gaussians.means.device)[:, None]
    log_scales = gaussians.log_scales.double() + float(np.log(scale))
    return replace(gaussians, means=means.float(), log_scales=log_scales.float())
