"""Which Gaussians need harmonics above the constant one: those whose radiance is seen to turn with the view.

3D Gaussian splatting gives them to all, most of which use them to fit noise. Here a Gaussian keeps them if
what training views see of it varies by more than an 8-bit display shows; the mean of what others lose goes to
their constant one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import cKDTree

from compose.base.arrays import Arrays
from compose.camera.camera import View
from splat.model.gaussians import SH_DC, Gaussians, apart
from splat.raster.differentiable import contributions, directional_radiance

# Standard deviation over views, on the perceptual scale, that a Gaussian's radiance must have: one step of an
# 8-bit display. Blended with others that do not vary with it, less of that is left in a pixel.
_LEAST_DEVIATION = 1 / 255


def turning_of(
    arrays: Arrays, gaussians: Gaussians, views: Sequence[View], shown: Callable[[float], Gaussians]
) -> tuple[torch.Tensor, torch.Tensor]:
    """How those M Gaussians turn that have harmonics above the constant one; 0 of what no view shows.

    Returns (3, M) what these harmonics add, mean over views, by what each view shows; and (M,) the root of
    its variance over views, of the channel that varies most. `shown` gives the Gaussians as at some time.
    """
    further = gaussians.directional
    assert further is not None
    total = torch.zeros(len(further))
    first, second = (torch.zeros(3, len(further)) for _ in range(2))
    for view in views:
        camera, now = view.camera, shown(view.time)
        pixels = np.ones((camera.height, camera.width, 1), np.float32)
        weight = contributions(arrays, now, camera, pixels)[further.index, 0]
        radiance = directional_radiance(further, now.means, camera.position)
        total += weight
        first += weight * radiance
        second += weight * radiance.square()
    seen = total > 0
    share = torch.where(seen, 1 / total.clamp(min=1e-30), 0)
    mean = first * share
    variance = (second * share - mean.square()).clamp(min=0)
    return mean, variance.amax(dim=0).sqrt()


def without_unseen_turning(
    arrays: Arrays,
    gaussians: Gaussians,
    views: Sequence[View],
    shown: Callable[[float], Gaussians],
    least: float = 1.0,
) -> Gaussians:
    """Gaussians, of which only those whose radiance visibly turns keep harmonics above the constant one.

    `least` is the share of what is visible by which it must turn; the rest is as for `turning_of`.
    """
    gaussians = apart(gaussians)
    assert gaussians.directional is not None
    index = gaussians.directional.index
    mean, deviation = turning_of(arrays, gaussians, views, shown)
    dropped = deviation < least * _LEAST_DEVIATION
    constant = gaussians.sh[0].index_add(1, index[dropped], mean[:, dropped] / SH_DC)
    kept = torch.zeros(len(gaussians), dtype=torch.bool).index_fill(0, index[~dropped], True)
    return replace(gaussians, sh=constant[None]).turning(kept)


def turning_as_nearest(new: Gaussians, known: Gaussians) -> Gaussians:
    """New Gaussians, of which those keep harmonics above the constant one whose nearest known one has any.

    Known ones whose centres are not finite count as none: they are about to be removed.
    """
    further = known.directional
    # Where all have them, as long as nobody has told, there is nothing to look up.
    if further is None or len(further) == len(known) or not len(new) or not new.degree:
        return new
    there = torch.nonzero(known.means.isfinite().all(dim=0))[:, 0]
    if not len(there):
        return new
    _, nearest = cKDTree(known.means[:, there].numpy().T).query(new.means.numpy().T)
    return new.turning(known.turns[there[torch.from_numpy(nearest)]])
