"""Cut-off frequency of the contrast sensitivity function stelaCSF (Mantiuk et al. 2022)."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Cycles per degree. Beyond some 45 degrees stelaCSF finds nothing visible at all; the cut-off stays at this.
_LOWEST_CUTOFF = 0.5


def stelacsf(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree at which full contrast is just visible, 0.5 to 64.

    For a static patch of one square degree at 100 cd/m2, in the temporal visual field, at eccentricities in
    degrees.
    """
    eccentricities, cutoffs = _stelacsf_table()
    return np.exp(np.interp(eccentricity, eccentricities, np.log(cutoffs)))


@cache
def _stelacsf_table() -> tuple[Array, Array]:
    """Eccentricities (481,) in degrees, and the frequencies (481,) at which the sensitivity falls to 1."""
    eccentricities = np.linspace(0, 120, 481)
    frequencies = np.exp2(np.linspace(-4, 6, 2001))
    # At every eccentricity the sensitivity falls with frequency beyond its peak.
    visible = _stelacsf_sensitivity(frequencies[None, :], eccentricities[:, None]) >= 1
    last = visible.shape[1] - 1 - np.argmax(visible[:, ::-1], axis=1)
    cutoff = np.where(visible.any(axis=1), frequencies[last], _LOWEST_CUTOFF)
    return eccentricities, np.maximum(cutoff, _LOWEST_CUTOFF)


def _stelacsf_sensitivity(frequency: Array, eccentricity: Array) -> Array:
    """Contrast sensitivity of the sustained channel at 0 Hz, 100 cd/m2, 1 square degree.

    The formula is that of the paper (section 4), the constants are those its authors fitted on 2022-01-26.
    The transient channel does not respond to a static image.
    """
    luminance, area = 100.0, 1.0
    peak = 65.4012 * (1 + 29.8305 / luminance) ** -0.20376
    peak *= 1 - (1 + 7.63446e-07 / luminance) ** -6.93565e09
    best = 1.56511 * (1 + 51.1941 / luminance) ** -0.245
    parabola = 10 ** (-((np.log10(frequency) - np.log10(best)) ** 2) / 2**1.12573)
    parabola = np.where(frequency < best, np.maximum(parabola, 1 - 0.0835553), parabola)
    critical = 270 / (1 + (frequency / 0.65) ** 2)
    foveal = peak * parabola * np.sqrt(critical / (1 + critical / area)) * frequency
    return foveal * 10 ** (-(0.0269434 + 0.0200995 * frequency) * eccentricity)
