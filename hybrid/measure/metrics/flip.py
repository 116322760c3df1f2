"""FLIP (Andersson et al. 2020) and HDR-FLIP (Andersson et al. 2021), if they are installed.

FLIP filters images as the eye does at a viewing distance, which is given in pixels per degree. Its evaluator
assumes 67, those of a 4K monitor at 0.7 m; here they are always those of the display for which a frame is
evaluated, as for FovVideoVDP.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, luminance, srgb_from_radiance
from hybrid.measure.metrics.pair import checked_pair

# Reach of FLIP's filters in degrees, rounded up: the widest one ends at three standard deviations.
_REACH = 24 / 67
# HDR-FLIP takes the longest exposure from the median luminance, at least the machine epsilon. If not even the
# maximum exceeds that, no exposure is left, and its evaluator ends the process.
_LEAST_LUMINANCE = 1e-6


def flip_map(image: Image, reference: Image, pixels_per_degree: float) -> NDArray[np.float32] | None:
    """(H, W) FLIP of linear radiance (H, W, 3), shown as sRGB.

    Args:
        image, reference: (H, W, 3) linear radiance.
        pixels_per_degree: of the display.

    Returns:
        The error in 0..1, 0 for no difference; None if the metric is not installed.

    Raises:
        UserError: the two images cannot be compared.
    """
    checked_pair(image, reference)
    return _evaluated(srgb_from_radiance(image), srgb_from_radiance(reference), "LDR", pixels_per_degree)


def hdr_flip_map(image: Image, reference: Image, pixels_per_degree: float) -> NDArray[np.float32] | None:
    """(H, W) HDR-FLIP of linear radiance (H, W, 3): the largest FLIP over a range of exposures.

    The reference alone determines the exposures.

    Args:
        image, reference: (H, W, 3) linear radiance.
        pixels_per_degree: of the display.

    Returns:
        The error in 0..1, 0 for no difference; None if the metric is not installed, or if the reference is
        black, so that it determines no exposure.

    Raises:
        UserError: the two images cannot be compared.
    """
    checked_pair(image, reference)
    if float(luminance(reference).max()) < _LEAST_LUMINANCE:
        return None
    return _evaluated(image, reference, "HDR", pixels_per_degree)


def flip(image: Image, reference: Image, pixels_per_degree: float) -> float | None:
    """Mean of `flip_map`; None if the metric is not installed."""
    error = flip_map(image, reference, pixels_per_degree)
    return None if error is None else float(error.mean())


def flip_reach(pixels_per_degree: float) -> int:
    """Pixels beyond which a pixel has no influence on a map."""
    return math.ceil(_REACH * pixels_per_degree)


def _evaluated(
    image: Image, reference: Image, kind: str, pixels_per_degree: float
) -> NDArray[np.float32] | None:
    try:
        import flip_evaluator
    except ImportError:
        return None
    inputs = (np.ascontiguousarray(one, dtype=np.float32) for one in (reference, image))
    error, _, _ = flip_evaluator.evaluate(
        *inputs, kind, inputsRGB=True, applyMagma=False, parameters={"ppd": float(pixels_per_degree)}
    )
    return np.asarray(error, dtype=np.float32).reshape(image.shape[:2])
