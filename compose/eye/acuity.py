"""Acuity models: what the eye resolves at each eccentricity.

An acuity model is a function from eccentricity in degrees to cut-off frequency in cycles per degree. Level of
detail, low-pass and sampling rate follow from the cut-off in the same way for all models.
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
    """An acuity model and how levels of detail follow from it.

    Attributes:
        cutoff: highest spatial frequency that is resolved, in cycles per degree, from eccentricities in
            degrees.
        relative: whether levels follow Fov-GS (Eq. 7): they depend on eccentricity alone, count from the edge
            of the full-quality region regardless of what the finest layer can show there, and each layer
            counts for the most that its pixels can hold. Otherwise a layer is replaced by the next one only
            where the eye cannot tell them apart, saliency included, and is sampled twice as finely as it was
            trained.
    """

    cutoff: Callable[[Array], Array]
    relative: bool = False


# Minimum angle of resolution a(e) = w0 + m e, in degrees (Fov-GS, section 4.1, after Guenter et al. 2012).
ACUITY_LIMIT = 1 / 48
ACUITY_SLOPE = 0.022  # 1.32 arcmin per degree
# How much more is resolved where the image draws attention (Fov-GS, Eq. 9).
SALIENCY_GAIN = 0.4
# The models of frames that must look right and of frames that must be quick, as compared in
# docs/measured/periphery.md.
DEFAULT_ACUITY_MODEL = "fovvideovdp"
QUICK_ACUITY_MODEL = "geisler-perry"


def minimum_angle(eccentricity: Array) -> Array:
    """Smallest angle in degrees that is resolved at an eccentricity in degrees (Fov-GS, Eq. 6)."""
    return ACUITY_LIMIT + ACUITY_SLOPE * np.asarray(eccentricity, dtype=np.float64)


def fov_gs(eccentricity: Array) -> Array:
    """Cut-off in cycles per degree, 1 / a(e) (Fov-GS, Eq. 9 without saliency)."""
    return 1 / minimum_angle(eccentricity)


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


def unlimited(eccentricity: Array) -> Array:
    """Infinity: no cut-off, everything is drawn in full detail."""
    return np.full(np.shape(eccentricity), np.inf)


ACUITY_MODELS = {
    "fov-gs": AcuityModel(fov_gs, relative=True),
    "stelacsf": AcuityModel(stelacsf),
    "geisler-perry": AcuityModel(geisler_perry),
    "fovvideovdp": AcuityModel(fovvideovdp),
    "none": AcuityModel(unlimited),
}


def acuity_model_named(name: str) -> AcuityModel:
    """The acuity model of that name.

    Raises:
        UserError: there is none.
    """
    if name not in ACUITY_MODELS:
        raise UserError(f"acuity model {name}: must be {', '.join(ACUITY_MODELS)}")
    return ACUITY_MODELS[name]


def with_saliency(cutoff: Array, saliency: Array) -> Array:
    """Cut-off raised where the image draws attention, saliency in 0..1 (Fov-GS, Eq. 9)."""
    return cutoff * (1 + SALIENCY_GAIN * saliency)
