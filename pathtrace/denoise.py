"""Intel Open Image Denoise on a rectangle of radiance with its guides."""

from __future__ import annotations

import mitsuba_oidn
import numpy as np
from numpy.typing import NDArray

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
    sides = radiance.shape[:2]
    even = tuple((0, side % 2) for side in sides)
    halves = (_halved(np.pad(image, (*even, (0, 0)), mode="edge")) for image in (radiance, albedo, normal))
    coarse_radiance, coarse_albedo, coarse_normal = halves
    light = denoise(coarse_radiance, coarse_albedo, coarse_normal, fast=True) / (coarse_albedo + _DARK)
    return (_doubled(light)[: sides[0], : sides[1]] * (albedo + _DARK)).astype(np.float32)


def _halved(image: Image) -> Image:
    """Means of 2 x 2 pixels."""
    return 0.25 * (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2])


def _doubled(image: Image) -> Image:
    """Twice as many rows and columns, linear in between."""
    for axis in (0, 1):
        rows = np.moveaxis(image, axis, 0)
        before, after = np.concatenate([rows[:1], rows[:-1]]), np.concatenate([rows[1:], rows[-1:]])
        both = np.stack([0.75 * rows + 0.25 * before, 0.75 * rows + 0.25 * after], axis=1)
        image = np.moveaxis(both.reshape(-1, *rows.shape[1:]), 0, axis).astype(np.float32)
    return image
