"""Spherical harmonics to linear radiance, for kernels."""

from __future__ import annotations

from typing import Any

import drjit as dr

from compose.image.colour import SRGB_DARK_VALUE, SRGB_GAMMA, SRGB_OFFSET, SRGB_SCALE, SRGB_SLOPE, srgb_power
from splat.model.gaussians import SH_CUBIC, SH_DC, SH_LINEAR, SH_QUADRATIC

# Radiance that a Gaussian can have at most; the sun's disc has 2e7 W / (m^2 sr), 1.6e9 cd / m^2. Its square,
# summed over all pixels of a frame and multiplied by what the gradient needs, still fits float32.
LARGEST_RADIANCE = 1e12
_LARGEST_PERCEPTUAL = srgb_power(LARGEST_RADIANCE)


def perceptual_radiance(sh: list[list[Any]], direction: list[Any]) -> list[Any]:
    """Perceptual radiance, three channels (N,), from those of each harmonic, along unit vectors x, y, z."""
    return [0.5 + channel for channel in sh_sums(sh, sh_basis(len(sh), direction))]


def sh_sums(sh: list[list[Any]], basis: list[Any]) -> list[Any]:
    """Sums of coefficients, three channels each, times their harmonics: three channels."""
    return [sum(row[c] * value for row, value in zip(sh, basis, strict=True)) for c in range(3)]


def sh_basis(count: int, direction: list[Any]) -> list[Any]:
    """The first 1, 4, 9 or 16 real spherical harmonics, with the signs of 3D Gaussian splatting's files.

    The direction is x, y, z of unit vectors, numbers of any kind.
    """
    x, y, z = direction
    basis: list[Any] = [SH_DC]
    if count > 1:
        basis += [-SH_LINEAR * y, SH_LINEAR * z, -SH_LINEAR * x]
    if count > 4:
        a, b, c = SH_QUADRATIC
        basis += [a * x * y, -a * y * z, b * (3 * z * z - 1), -a * x * z, c * (x * x - y * y)]
    if count > 9:
        a, b, c, d, e = SH_CUBIC
        basis += [
            -a * y * (3 * x * x - y * y),
            b * x * y * z,
            -c * y * (5 * z * z - 1),
            d * z * (5 * z * z - 3),
            -c * x * (5 * z * z - 1),
            e * z * (x * x - y * y),
            -a * x * (x * x - 3 * y * y),
        ]
    return basis


def radiance_from_perceptual(perceptual: Any) -> Any:
    """Inverse of the sRGB curve, continued above 1 by the same power.

    Negative values give 0, and what would exceed `LARGEST_RADIANCE` gives that: as infinity, it would turn
    every pixel near the Gaussian into a NaN.
    """
    value = dr.clip(perceptual, 0, _LARGEST_PERCEPTUAL)
    shifted = dr.maximum(value, SRGB_DARK_VALUE) + SRGB_OFFSET
    bright = dr.exp2(SRGB_GAMMA * dr.log2(shifted * (1 / SRGB_SCALE)))
    return dr.select(value <= SRGB_DARK_VALUE, value * (1 / SRGB_SLOPE), bright)
