"""Acuity models: what the eye resolves at each eccentricity, and the steps in which detail follows it.

An acuity model is a function from eccentricity in degrees to cut-off frequency in cycles per degree. Level of
detail, low-pass and sampling rate follow from the cut-off in the same way for all models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError

Array = NDArray[np.float64]

# The fastest model of which FovVideoVDP notices less than 0.1 JOD, as compared in docs/measured.
DEFAULT_ACUITY_MODEL = "fovvideovdp"
COARSEST_RATE = 4  # log2 of pixels per sample along each axis
# Cycles per degree. Beyond some 45 degrees stelaCSF finds nothing visible at all; the cut-off stays at this.
_LOWEST_CUTOFF = 0.5
# Of `limit_sensitivity`; and of `resolution_limit`, the standard deviation over people in octaves in the
# fovea, what it grows per degree, and up to how many degrees.
_LIMIT = (1.0268, 0.0064992, 0.0316258, 0.721685, 29.0309)
_LIMIT_SPREAD = (0.181, 0.0191, 20.0)


@dataclass(frozen=True)
class AcuityModel:
    """An acuity model and how levels of detail follow from it.

    If `relative`, levels follow Fov-GS (Eq. 7): they depend on eccentricity alone, count from the edge of the
    full-quality region regardless of what the finest layer can show there, and each layer counts for the most
    that its pixels can hold. Otherwise a layer is replaced by the next one only where the eye cannot tell
    them apart, saliency included, and is sampled twice as finely as it was trained.
    """

    cutoff: Callable[[Array], Array]  # cycles per degree that are resolved, from eccentricities in degrees
    relative: bool = False


def fov_gs(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree, 1 / a(e) (Fov-GS, Eq. 9 without saliency).

    The minimum angle of resolution a(e) = w0 + m e, with w0 = 1/48 degree and m = 0.022 (1.32 arcmin per
    degree), is that of Fov-GS (Eq. 6, after Guenter et al. 2012).
    """
    return 1 / (1 / 48 + 0.022 * np.asarray(eccentricity, dtype=np.float64))


def geisler_perry(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree at which full contrast is just visible (Geisler and Perry 1998, Eq. 1).

    The contrast threshold is CT0 exp(alpha f (e + e2) / e2) with CT0 = 1/64, alpha = 0.106, e2 = 2.3 degrees.
    """
    return 2.3 * np.log(64) / (0.106 * (np.asarray(eccentricity, dtype=np.float64) + 2.3))


def fovvideovdp(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree at which FovVideoVDP just sees full contrast (Mantiuk et al. 2021).

    A fit to its sensitivity, in the form of a minimum angle of resolution: 32, 14.3, 10.3 and
    8.3 cycles per degree at 0, 10, 20 and 30 degrees, within 2 % of the metric's.
    """
    return 1 / (1 / 32 + 0.00672 * np.asarray(eccentricity, dtype=np.float64) ** 0.76)


def stelacsf(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree at which full contrast is just visible, 0.5 to 64, after stelaCSF.

    For a static patch of one square degree at 100 cd/m2, in the temporal visual field.
    """
    return _where_visible(_stelacsf_sensitivity, eccentricity)


def resolution_limit(eccentricity: Array, observers: float = 0.5) -> Array:
    """Cut-off in cycles per degree, 0.5 to 64, at which a share of observers no longer sees a grating.

    Fitted to people (`limit_sensitivity`); the logarithm of their cut-offs is normally distributed, and
    spreads with eccentricity up to 20 degrees, beyond which it was not measured. The share `observers`
    resolves no more; it is over 0 and under 1.
    """
    eccentricity = np.asarray(eccentricity, dtype=np.float64)
    foveal, per_degree, farthest = _LIMIT_SPREAD
    spread = foveal + per_degree * np.minimum(eccentricity, farthest)
    beyond = np.exp2(NormalDist().inv_cdf(observers) * spread)
    return np.maximum(_where_visible(limit_sensitivity, eccentricity) * beyond, _LOWEST_CUTOFF)


def _where_visible(sensitivity: Callable[[Array, Array], Array], eccentricity: Array) -> Array:
    """Frequency in cycles per degree at which a contrast sensitivity falls to 1; 0.5 to 64."""
    eccentricities, cutoffs = _cutoff_table(sensitivity)
    return np.exp(np.interp(eccentricity, eccentricities, np.log(cutoffs)))


@cache
def _cutoff_table(sensitivity: Callable[[Array, Array], Array]) -> tuple[Array, Array]:
    """Eccentricities (481,) in degrees, and the frequencies (481,) at which the sensitivity falls to 1."""
    eccentricities = np.linspace(0, 120, 481)
    frequencies = np.exp2(np.linspace(-4, 6, 2001))
    # At every eccentricity the sensitivity falls with frequency beyond its peak.
    visible = sensitivity(frequencies[None, :], eccentricities[:, None]) >= 1
    last = visible.shape[1] - 1 - np.argmax(visible[:, ::-1], axis=1)
    cutoff = np.where(visible.any(axis=1), frequencies[last], _LOWEST_CUTOFF)
    return eccentricities, np.maximum(cutoff, _LOWEST_CUTOFF)


def _stelacsf_sensitivity(frequency: Array, eccentricity: Array) -> Array:
    """Contrast sensitivity of the sustained channel at 0 Hz, 100 cd/m2, 1 square degree."""
    foveal = _foveal_sensitivity(frequency, 100.0, 1.0)
    return foveal * 10 ** (-(0.0269434 + 0.0200995 * frequency) * eccentricity)


def limit_sensitivity(
    frequency: Array,
    eccentricity: Array,
    luminance: Array | float = 100.0,
    area: Array | float = np.pi,
    parameters: tuple[float, ...] = _LIMIT,
) -> Array:
    """Contrast sensitivity to static gratings, fitted to people.

    In the fovea it is that of stelaCSF, less what the optics and receptors take of high frequencies: the
    square of the frequency in the exponent. With eccentricity e its logarithm falls by (a + b f^c) e. The
    parameters are fitted by `python -m benchmarks.fit_acuity` to the finest gratings that 18 people saw at 0,
    10 and 20 degrees (Ashraf, Chapiro and Mantiuk 2025) and to the achromatic points of castleCSF (Ashraf et
    al. 2024) up to 1 Hz, out to 30 degrees, each study with a factor of its own. The gain is that of the
    finest gratings; the other studies' is a tenth of it. Luminance matters little: at 10 and 1,000 cd/m2 the
    cut-off is 5 % lower and 1 % higher.

    Frequency is in cycles per degree, over 0, eccentricity in degrees, luminance in cd/m2, the grating's area
    in square degrees. Parameters are log10 of the gain, a, b, c, and the frequency whose sensitivity the
    optics divide by 10.
    """
    gain, constant, slope, power, optics = parameters
    falls = (constant + slope * frequency**power) * eccentricity + (frequency / optics) ** 2
    return _foveal_sensitivity(frequency, luminance, area) * 10 ** (gain - falls)


def _foveal_sensitivity(frequency: Array, luminance: Array | float, area: Array | float) -> Array:
    """Contrast sensitivity of stelaCSF's sustained channel at 0 Hz and 0 degrees.

    The formula is that of the paper (section 4), the constants are those its authors fitted on 2022-01-26.
    The transient channel does not respond to a static image.
    """
    peak = 65.4012 * (1 + 29.8305 / luminance) ** -0.20376
    peak = peak * (1 - (1 + 7.63446e-07 / luminance) ** -6.93565e09)
    best = 1.56511 * (1 + 51.1941 / luminance) ** -0.245
    parabola = 10 ** (-((np.log10(frequency) - np.log10(best)) ** 2) / 2**1.12573)
    parabola = np.where(frequency < best, np.maximum(parabola, 1 - 0.0835553), parabola)
    critical = 270 / (1 + (frequency / 0.65) ** 2)
    return peak * parabola * np.sqrt(critical / (1 + critical / area)) * frequency


def unlimited(eccentricity: Array) -> Array:
    """Infinity: no cut-off, everything is drawn in full detail."""
    return np.full(np.shape(eccentricity), np.inf)


ACUITY_MODELS = {
    "fov-gs": AcuityModel(fov_gs, relative=True),
    "stelacsf": AcuityModel(stelacsf),
    "geisler-perry": AcuityModel(geisler_perry),
    "fovvideovdp": AcuityModel(fovvideovdp),
    "resolution-limit": AcuityModel(resolution_limit),
    "resolution-limit-95": AcuityModel(partial(resolution_limit, observers=0.95)),
    "none": AcuityModel(unlimited),
}


def acuity_model_named(name: str) -> AcuityModel:
    """The acuity model of that name; UserError if there is none."""
    if name not in ACUITY_MODELS:
        raise UserError(f"acuity model {name}: must be {', '.join(ACUITY_MODELS)}")
    return ACUITY_MODELS[name]


@dataclass(frozen=True)
class Step:
    """A layer at a rate, and where it begins to be drawn."""

    octaves: float  # log2 of the pixels per cycle of the cut-off at which it begins to fade in
    layer: int  # 1, the coarsest, to L
    rate: int  # log2 of pixels per sample along each axis


def detail_steps(
    finest: float, ahead: float, finest_rates: tuple[int, ...], lowest: int, fade: float
) -> tuple[Step, ...]:
    """What is drawn as the cut-off falls: steps from fine to coarse, layer after layer, each at one rate.

    The first is drawn however high the cut-off is. A layer fades into the next one just before the boundary
    of its level, where Fov-GS's Eq. 7 steps down: at the edge of the full-quality region the second layer is
    drawn alone. The rate changes with the layer, to the coarsest one that still carries what the cut-off lets
    through there. It changes on its own only where one layer serves several octaves, as the finest and the
    coarsest do.

    Args:
        finest: the cut-off, in cycles per pixel, down to which layer L is required.
        ahead: the same for a viewer who looks straight ahead. Rates follow from it, because they must not
            change with the gaze: a whole layer would pop.
        finest_rates, lowest: as in LayerRange (compose.eye.detail).
        fade: fraction of an octave over which a step fades in.
    """
    layers = len(finest_rates)
    steps = [Step(-np.inf, layers, finest_rates[-1])]
    first = -np.log2(finest) - fade if lowest < layers else np.inf
    # A rate carries frequencies up to half its samples: rate r begins at 1 + r octaves.
    for rate in range(steps[0].rate + 1, COARSEST_RATE + 1):
        if lowest == layers or 1 + rate + fade <= -np.log2(ahead) - fade:
            steps.append(Step(1.0 + rate, layers, rate))
    for layer in range(layers - 1, lowest - 1, -1):
        below = layers - 1 - layer
        carried = min(int(np.floor(below - np.log2(ahead) - 1)), COARSEST_RATE)
        steps.append(Step(first + below, layer, max(carried, steps[-1].rate, finest_rates[layer - 1])))
    for rate in range(steps[-1].rate + 1, COARSEST_RATE + 1):
        steps.append(Step(max(1.0 + rate, steps[-1].octaves + fade), lowest, rate))
    return tuple(steps)
