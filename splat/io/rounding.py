"""Steps to which sizes, opacities and colours are rounded, chosen by what the eye and the rasterizer see.

Steps of equal size have an error that is known for any Gaussian; ranges that are fitted to a scene would lose
it to a few that are extreme. Values that are rare take few bits once they are packed. What is decoded encodes
to the same codes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from splat.model.gaussians import SH_DC
from splat.model.rows import Floats

# Whole numbers of the type that a file has.
Codes = NDArray[Any]

# Steps per unit of a logarithm: sizes are right to 1.6 %. Any float32's exponent lies within the bound.
_PER_LOG, _MOST_LOG = 32, 128.0
# Below 1/255 nothing is drawn, above 0.99 nothing is told apart: eight bits are what opacity has.
_OPACITIES = 256
# Steps per unit of the perceptual scale: colours are right to 1/512, half a step of an 8-bit display.
_PER_COLOUR = 256
# Then harmonics up to the second degree, together, are as right as the colour: the mean square of each over
# directions is 1 / (4 pi) of its coefficient's.
_PER_HARMONIC = 256
# Larger colours and harmonics end there; both are inside of float32.
_LARGEST = 8e37


def codes_of_log_scales(log_scales: Floats) -> Codes:
    """Codes, int16, of natural logarithms of sizes; beyond those of float32's numbers they end."""
    return np.rint(np.clip(log_scales, -_MOST_LOG, _MOST_LOG) * _PER_LOG).astype(np.int16)


def log_scales_of_codes(codes: Codes) -> Floats:
    """Natural logarithms of sizes, within 1/64 of what was encoded."""
    return np.clip(codes / _PER_LOG, -_MOST_LOG, _MOST_LOG)


def codes_of_opacities(logits: Floats) -> Codes:
    """Codes, uint8, of opacities before the sigmoid."""
    return np.minimum(np.floor(expit(logits) * _OPACITIES), _OPACITIES - 1).astype(np.uint8)


def logits_of_codes(codes: Codes) -> Floats:
    """Opacities before the sigmoid; after it, within 1/512 of what was encoded, and inside of (0, 1)."""
    opacity = (codes + 0.5) / _OPACITIES
    return np.log(opacity / (1 - opacity))


def codes_of_constants(coefficients: Floats) -> Codes:
    """Codes, int16, of constant spherical harmonics: of the colours that they stand for."""
    return _unsigned(_steps(0.5 + SH_DC * coefficients, _PER_COLOUR))


def constants_of_codes(codes: Codes) -> Floats:
    """Constant harmonics; their colours are within 1/512, or of larger ones within that share."""
    return (_expanded(_signed(codes) / _PER_COLOUR) - 0.5) / SH_DC


def codes_of_harmonics(coefficients: Floats) -> Codes:
    """Codes, int16, of spherical harmonics that depend on direction."""
    return _unsigned(_steps(coefficients, _PER_HARMONIC))


def harmonics_of_codes(codes: Codes) -> Floats:
    """Harmonics that depend on direction, within 1/512, or of larger ones within that share."""
    return _expanded(_signed(codes) / _PER_HARMONIC)


def _steps(values: Floats, per_unit: int) -> Floats:
    """Companded values in whole steps, of which there are fewer than 2^15 of each sign."""
    most = np.floor(_companded(np.array(_LARGEST)) * per_unit)
    return np.clip(np.rint(_companded(values) * per_unit), -most, most)


def _companded(values: Floats) -> Floats:
    """Values up to 1 as they are, larger ones by their logarithm: light has no largest value."""
    size = np.abs(values)
    return np.where(size <= 1, values, np.copysign(1 + np.log(np.maximum(size, 1)), values))


def _expanded(values: Floats) -> Floats:
    """The inverse of `_companded`."""
    size = np.abs(values)
    return np.where(size <= 1, values, np.copysign(np.exp(np.maximum(size, 1) - 1), values))


def _unsigned(values: Floats) -> Codes:
    """0, -1, 1, -2, ... as 0, 1, 2, 3, ...: small ones of both signs then have the same upper byte, 0."""
    whole = values.astype(np.int32)
    return ((whole << 1) ^ (whole >> 31)).astype(np.uint16).view(np.int16)


def _signed(codes: Codes) -> Codes:
    """The inverse of `_unsigned`."""
    unsigned = codes.view(np.uint16).astype(np.int32)
    return (unsigned >> 1) ^ -(unsigned & 1)
