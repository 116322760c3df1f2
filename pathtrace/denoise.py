"""Intel Open Image Denoise on a rectangle of radiance with its guides."""

from __future__ import annotations

import mitsuba_oidn
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

Image = NDArray[np.float32]
# Light is not told where albedo is below this.
_DARK = 0.1


def denoise(radiance: Image, albedo: Image, normal: Image, fast: bool = False) -> Image:
    """Removes Monte Carlo noise.

    Args:
        radiance: (H, W, 3) linear, unbounded; its pixels must be box-filtered and uncorrelated.
        albedo: (H, W, 3) in 0..1.
        normal: (H, W, 3), components in -1..1.
        fast: the quicker network, for frames shown in real time.

    Returns:
        (H, W, 3) denoised radiance.
    """
    quality = mitsuba_oidn.Quality.Fast if fast else mitsuba_oidn.Quality.High
    return np.asarray(
        mitsuba_oidn.denoise(
            np.ascontiguousarray(radiance, dtype=np.float32),
            np.clip(albedo, 0, 1).astype(np.float32),
            np.ascontiguousarray(normal, dtype=np.float32),
            hdr=True,
            quality=quality,
        )
    )


def denoise_coarsely(radiance: Image, albedo: Image, normal: Image) -> Image:
    """As `denoise`, at half the resolution, with the albedo's detail put back: less than half the time."""
    coarse_radiance, coarse_albedo, coarse_normal = map(_halved, (radiance, albedo, normal))
    light = denoise(coarse_radiance, coarse_albedo, coarse_normal, fast=True) / (coarse_albedo + _DARK)
    return _doubled(light)[: radiance.shape[0], : radiance.shape[1]] * (albedo + _DARK)


def _halved(image: Image) -> Image:
    """Means of 2 x 2 pixels, at odd ends of fewer."""
    return _interleaved(functional.avg_pool2d(_planes(image), 2, ceil_mode=True))


def _doubled(image: Image) -> Image:
    """Twice as many rows and columns, linear in between."""
    return _interleaved(functional.interpolate(_planes(image), scale_factor=2, mode="bilinear"))


def _planes(image: Image) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(image, dtype=np.float32)).permute(2, 0, 1)[None]


def _interleaved(planes: Tensor) -> Image:
    return np.asarray(planes[0].permute(1, 2, 0).contiguous().numpy())
