"""Laws of the eye: from eccentricity to the highest spatial frequency it resolves, and to a level of detail.

A law is a function from eccentricity in degrees to cut-off frequency in cycles per degree. Everything else
follows from the cut-off in the same way for all of them: the level, the low-pass, the sampling rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from compose.errors import UserError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Law:
    """A law of the eye.

    Attributes:
        cutoff: highest spatial frequency that is resolved, in cycles per degree, from eccentricities in
            degrees.
        relative: whether levels are as Fov-GS has them (Eq. 7): by eccentricity alone, counted from the
            edge of the full-quality region, whatever the finest layer can show there, and each layer taken
            for what its pixels can hold at most. Otherwise a layer is only left where the eye cannot tell
            the next one from it, what draws attention included, and is sampled twice as finely as it was
            trained.
    """

    cutoff: Callable[[Array], Array]
    relative: bool = False


# Minimum angle of resolution a(e) = w0 + m e, in degrees (Fov-GS, section 4.1, after Guenter et al. 2012).
ACUITY_LIMIT = 1 / 48
ACUITY_SLOPE = 0.022  # 1.32 arcmin per degree
# How much more is resolved where the picture draws attention (Fov-GS, Eq. 9).
SALIENCY_GAIN = 0.4
# Beyond some 45 degrees stelaCSF finds nothing visible at all; no cut-off is taken below this.
_LOWEST_CUTOFF = 0.5
# The law that a viewer is given who asks for none; docs/measured.md has the comparison.
DEFAULT_LAW = "geisler-perry"


def minimum_angle(eccentricity: Array) -> Array:
    """Smallest angle in degrees that is resolved at an eccentricity in degrees (Fov-GS, Eq. 6)."""
    return ACUITY_LIMIT + ACUITY_SLOPE * np.asarray(eccentricity, dtype=np.float64)


def fov_gs(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree, 1 / a(e) (Fov-GS, Eq. 9 without saliency)."""
    return 1 / minimum_angle(eccentricity)


def stelacsf(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree, where stelaCSF sees full contrast just so (Mantiuk et al. 2022).

    For a still patch of one square degree at 100 cd/m2, in the temporal visual field; at most 64.
    """
    eccentricities, cutoffs = _stelacsf_table()
    return np.exp(np.interp(eccentricity, eccentricities, np.log(cutoffs)))


def geisler_perry(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree: where contrast 1 is seen just so (Geisler and Perry 1998, Eq. 1).

    The contrast threshold is CT0 exp(alpha f (e + e2) / e2) with CT0 = 1/64, alpha = 0.106, e2 = 2.3 degrees.
    """
    return 2.3 * np.log(64) / (0.106 * (np.asarray(eccentricity, dtype=np.float64) + 2.3))


def unlimited(eccentricity: Array) -> Array:
    """No cut-off: everything is drawn as finely as it can be."""
    return np.full(np.shape(eccentricity), np.inf)


LAWS = {
    "fov-gs": Law(fov_gs, relative=True),
    "stelacsf": Law(stelacsf),
    "geisler-perry": Law(geisler_perry),
    "none": Law(unlimited),
}


def law_named(name: str) -> Law:
    """The law of that name.

    Raises:
        UserError: there is none.
    """
    if name not in LAWS:
        raise UserError(f"--law {name}: must be {', '.join(LAWS)}")
    return LAWS[name]


def with_saliency(cutoff: Array, saliency: Array) -> Array:
    """Cut-off where the picture draws attention, saliency in 0..1 (Fov-GS, Eq. 9)."""
    return cutoff * (1 + SALIENCY_GAIN * saliency)


def continuous_level(cutoff: Array, finest: float, layers: int) -> Array:
    """Level, not rounded and not limited to 1..L: lambda = L - log2(finest / f).

    Fov-GS's Eq. 7 without its steps, as f = 1 / a, when the finest frequency is the cut-off f(e0) at the
    edge of the full-quality region: with L = 4 and e0 = 10 degrees its law then gives whole levels at 10,
    20.95, 42.84 and 86.6 degrees.

    Args:
        cutoff: f, inf where nothing is cut off; there the level is inf.
        finest: the frequency up to which layer L is needed, in the same unit.
        layers: L.
    """
    return layers + np.log2(np.asarray(cutoff, dtype=np.float64) / finest)


@cache
def _stelacsf_table() -> tuple[Array, Array]:
    """Eccentricities in degrees, and the frequency at which the sensitivity falls to 1."""
    eccentricities = np.linspace(0, 120, 481)
    frequencies = np.exp2(np.linspace(-4, 6, 2001))
    # In all of them the sensitivity has its peak first and falls from there on.
    visible = _stelacsf_sensitivity(frequencies[None, :], eccentricities[:, None]) >= 1
    last = visible.shape[1] - 1 - np.argmax(visible[:, ::-1], axis=1)
    cutoff = np.where(visible.any(axis=1), frequencies[last], _LOWEST_CUTOFF)
    return eccentricities, np.maximum(cutoff, _LOWEST_CUTOFF)


def _stelacsf_sensitivity(frequency: Array, eccentricity: Array) -> Array:
    """Contrast sensitivity of the sustained channel at 0 Hz, 100 cd/m2, 1 square degree.

    The form is that of the paper (section 4), the constants those its authors fitted on 2022-01-26. The
    transient channel has no share in a still picture.
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
