"""acuity models: from eccentricity to the highest spatial frequency it resolves, and to a level of detail.

A acuity model is a function from eccentricity in degrees to cut-off frequency in cycles per degree. Everything else
follows from the cut-off in the same way for all of them: the level, the low-pass, the sampling rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.eye.stelacsf import stelacsf

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AcuityModel:
    """A acuity model.

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
# The acuity model that a viewer is given who asks for none; docs/measured.md has the comparison.
DEFAULT_ACUITY_MODEL = "geisler-perry"


def minimum_angle(eccentricity: Array) -> Array:
    """Smallest angle in degrees that is resolved at an eccentricity in degrees (Fov-GS, Eq. 6)."""
    return ACUITY_LIMIT + ACUITY_SLOPE * np.asarray(eccentricity, dtype=np.float64)


def fov_gs(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree, 1 / a(e) (Fov-GS, Eq. 9 without saliency)."""
    return 1 / minimum_angle(eccentricity)


def geisler_perry(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree: where contrast 1 is seen just so (Geisler and Perry 1998, Eq. 1).

    The contrast threshold is CT0 exp(alpha f (e + e2) / e2) with CT0 = 1/64, alpha = 0.106, e2 = 2.3 degrees.
    """
    return 2.3 * np.log(64) / (0.106 * (np.asarray(eccentricity, dtype=np.float64) + 2.3))


def unlimited(eccentricity: Array) -> Array:
    """No cut-off: everything is drawn as finely as it can be."""
    return np.full(np.shape(eccentricity), np.inf)


ACUITY_MODELS = {
    "fov-gs": AcuityModel(fov_gs, relative=True),
    "stelacsf": AcuityModel(stelacsf),
    "geisler-perry": AcuityModel(geisler_perry),
    "none": AcuityModel(unlimited),
}


def acuity_model_named(name: str) -> AcuityModel:
    """The acuity model of that name.

    Raises:
        UserError: there is none.
    """
    if name not in ACUITY_MODELS:
        raise UserError(f"--acuity-model {name}: must be {', '.join(ACUITY_MODELS)}")
    return ACUITY_MODELS[name]


def with_saliency(cutoff: Array, saliency: Array) -> Array:
    """Cut-off where the picture draws attention, saliency in 0..1 (Fov-GS, Eq. 9)."""
    return cutoff * (1 + SALIENCY_GAIN * saliency)


def continuous_level(cutoff: Array, finest: float, layers: int) -> Array:
    """Level, not rounded and not limited to 1..L: lambda = L - log2(finest / f).

    Fov-GS's Eq. 7 without its steps, as f = 1 / a, when the finest frequency is the cut-off f(e0) at the
    edge of the full-quality region: with L = 4 and e0 = 10 degrees its acuity model then gives whole levels at 10,
    20.95, 42.84 and 86.6 degrees.

    Args:
        cutoff: f, inf where nothing is cut off; there the level is inf.
        finest: the frequency up to which layer L is needed, in the same unit.
        layers: L.
    """
    return layers + np.log2(np.asarray(cutoff, dtype=np.float64) / finest)
