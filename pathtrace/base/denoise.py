"""Intel Open Image Denoise for path-traced images and their auxiliary features."""

from __future__ import annotations

import math

import mitsuba_oidn
import numpy as np

from compose.image.colour import Image

# Added to the albedo before radiance is divided by it, so that dark surfaces do not amplify noise.
_ALBEDO_OFFSET = 0.1
# Where all radiance is below 1e-8, OIDN finds no exposure and returns some 1e-6 of an image of its own.
# Images with a smaller peak than this are scaled by a power of two, exactly, before and after.
_LEAST_PEAK = 2.0**-8


def denoise(radiance: Image, albedo: Image, normal: Image, quick: bool = False) -> Image:
    """Removes Monte Carlo noise.

    Args:
        radiance: (H, W, 3) linear, unbounded; pixels must be box-filtered and uncorrelated.
        albedo: (H, W, 3), clipped to 0..1.
        normal: (H, W, 3), components in -1..1.
        quick: uses the quicker network, for frames shown in real time.

    Returns:
        (H, W, 3) denoised radiance.
    """
    quality = mitsuba_oidn.Quality.Fast if quick else mitsuba_oidn.Quality.High
    peak = float(radiance.max(initial=0))
    if peak == 0:
        # OIDN shows up to 8e-4 where there is no light at all.
        return np.zeros(radiance.shape, dtype=np.float32)
    exponent = math.frexp(peak)[1] if 0 < peak < _LEAST_PEAK else 0
    denoised = np.asarray(
        mitsuba_oidn.denoise(
            np.ascontiguousarray(np.ldexp(radiance, -exponent) if exponent else radiance, dtype=np.float32),
            np.clip(albedo, 0, 1).astype(np.float32),
            np.ascontiguousarray(normal, dtype=np.float32),
            hdr=True,
            quality=quality,
        )
    )
    return np.ldexp(denoised, exponent) if exponent else denoised


def denoise_coarsely(radiance: Image, albedo: Image, normal: Image) -> Image:
    """Denoises at half the resolution and restores the albedo's detail, in less than half the time.

    Args and result as of `denoise`.
    """
    coarse_radiance, coarse_albedo, coarse_normal = map(_halved, (radiance, albedo, normal))
    # Radiance over albedo varies slowly: it loses little at half the resolution.
    light = denoise(coarse_radiance, coarse_albedo, coarse_normal, quick=True) / (
        coarse_albedo + _ALBEDO_OFFSET
    )
    return _doubled(light)[: radiance.shape[0], : radiance.shape[1]] * (albedo + _ALBEDO_OFFSET)


def _halved(image: Image) -> Image:
    """(ceil(H / 2), ceil(W / 2), 3) means of 2 x 2 pixels; an odd last row or column is repeated."""
    height, width = image.shape[:2]
    if height % 2 or width % 2:
        image = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return np.float32(0.25) * (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2])


def _doubled(image: Image) -> Image:
    """(2 H, 2 W, 3) by linear interpolation; the border is repeated."""
    for axis in (0, 1):
        # Each new pixel centre lies a quarter of the way from an old one to the next.
        ahead, behind = (np.roll(image, shift, axis) for shift in (-1, 1))
        last, first = (slice(None),) * axis + (slice(-1, None),), (slice(None),) * axis + (slice(0, 1),)
        ahead[last], behind[first] = image[last], image[first]
        near = np.float32(0.75) * image
        pair = near + np.float32(0.25) * behind, near + np.float32(0.25) * ahead
        shape = [side * (1 + (number == axis)) for number, side in enumerate(image.shape)]
        image = np.stack(pair, axis=axis + 1).reshape(shape)
    return image
