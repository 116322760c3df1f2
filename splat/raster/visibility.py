"""Which Gaussians a view may show, and what each contributes to its pixels (Fov-GS, Eq. 1)."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np
import torch
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.image.colour import SRGB_GAMMA, SRGB_OFFSET, SRGB_SCALE, linear_power
from splat.model.gaussians import SH_DC, Gaussians
from splat.raster.differentiable import aligned_rows, render_differentiable
from splat.raster.projection import PIXEL_FILTER, may_show


def visible(arrays: Arrays, gaussians: Gaussians, camera: Camera) -> torch.Tensor:
    """(M,) int64 indices of all Gaussians that are drawn in a camera's frame, and of some beside it."""
    means, log_scales = gaussians.means, gaussians.log_scales
    if not len(gaussians):
        return torch.zeros(0, dtype=torch.int64, device=means.device)
    rows = aligned_rows(arrays, [means, log_scales])
    longest = dr.exp(dr.maximum(dr.maximum(rows[3], rows[4]), rows[5]))
    index = arrays.plain.Int(dr.compress(may_show(arrays, rows[:3], longest, camera, PIXEL_FILTER)))
    return arrays.to_torch(index, means.device).long()


# Opacity below which a pixel shows no Gaussian.
_LEAST_OPACITY = 1 / 255
_CHANNELS = 3
# Radiance of a Gaussian without spherical harmonics, and its derivative by the constant one.
_GREY = linear_power(0.5)
_GREY_SLOPE = SH_DC * SRGB_GAMMA / SRGB_SCALE * ((0.5 + SRGB_OFFSET) / SRGB_SCALE) ** (SRGB_GAMMA - 1)


def contributions(
    arrays: Arrays, gaussians: Gaussians, camera: Camera, weights: NDArray[np.float32]
) -> torch.Tensor:
    """(N, C) sums of what N Gaussians contribute to pixels of a view, times weights (H, W, C) of these.

    To a pixel, Gaussian m contributes c_m = alpha_m prod_{n<m} (1 - alpha_n), over the sum of that over all
    Gaussians: Eq. 1 with the product up to m - 1 and the inverse covariance, without which it would not be
    what is blended. It is the derivative of a rendered pixel by the colour of the Gaussian.
    """
    found = torch.zeros(len(gaussians), weights.shape[2])
    if not len(gaussians):
        return found
    for first in range(0, weights.shape[2], _CHANNELS):
        part = torch.from_numpy(np.ascontiguousarray(weights[..., first : first + _CHANNELS]))
        sh = torch.zeros(1, 3, len(gaussians), requires_grad=True)
        image = render_differentiable(arrays, replace(gaussians, sh=sh, directional=None), camera)
        opacity = image.detach()[..., :1] / _GREY
        share = torch.where(opacity > _LEAST_OPACITY, part / opacity.clamp(min=_LEAST_OPACITY), 0)
        (image[..., : share.shape[-1]] * share).sum().backward()
        assert sh.grad is not None
        found[:, first : first + _CHANNELS] = sh.grad[0, : share.shape[-1]].T / _GREY_SLOPE
    return found
