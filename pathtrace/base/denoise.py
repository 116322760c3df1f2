"""Intel Open Image Denoise on a rectangle of radiance with its auxiliary features."""

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
    coarse_radiance, coarse_albedo, coarse_normal = map(_halved, (radiance, albedo, normal))
    light = denoise(coarse_radiance, coarse_albedo, coarse_normal, fast=True) / (coarse_albedo + _DARK)
    return _doubled(light)[: radiance.shape[0], : radiance.shape[1]] * (albedo + _DARK)


def _halved(image: Image) -> Image:
    """Means of 2 x 2 pixels, at odd ends of fewer."""
    height, width = image.shape[:2]
    if height % 2 or width % 2:
        image = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return np.float32(0.25) * (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2])


def _doubled(image: Image) -> Image:
    """Twice as many rows and columns, linear in between."""
    for axis in (0, 1):
        # Each new place lies a quarter of the way to the next one.
        ahead, behind = (np.roll(image, shift, axis) for shift in (-1, 1))
        last, first = (slice(None),) * axis + (slice(-1, None),), (slice(None),) * axis + (slice(0, 1),)
        ahead[last], behind[first] = image[last], image[first]
        near = np.float32(0.75) * image
        pair = near + np.float32(0.25) * behind, near + np.float32(0.25) * ahead
        shape = [side * (1 + (number == axis)) for number, side in enumerate(image.shape)]
        image = np.stack(pair, axis=axis + 1).reshape(shape)
    return image
