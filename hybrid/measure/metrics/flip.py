"""FLIP (Andersson et al. 2020) and HDR-FLIP (Andersson et al. 2021), if they are installed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, srgb_from_radiance


def flip_map(image: Image, reference: Image) -> NDArray[np.float32] | None:
    """(H, W) FLIP of linear radiance (H, W, 3), shown as sRGB at 67 pixels per degree.

    Returns:
        The error in 0..1, 0 for no difference; None if the metric is not installed.
    """
    return _evaluated(srgb_from_radiance(image), srgb_from_radiance(reference), "LDR")


def hdr_flip_map(image: Image, reference: Image) -> NDArray[np.float32] | None:
    """(H, W) HDR-FLIP of linear radiance (H, W, 3): the largest FLIP over a range of exposures.

    The reference alone determines the exposures.

    Returns:
        The error in 0..1, 0 for no difference; None if the metric is not installed.
    """
    return _evaluated(image, reference, "HDR")


def flip(image: Image, reference: Image) -> float | None:
    """Mean of `flip_map`; None if the metric is not installed."""
    error = flip_map(image, reference)
    return None if error is None else float(error.mean())


def _evaluated(image: Image, reference: Image, kind: str) -> NDArray[np.float32] | None:
    try:
        import flip_evaluator
    except ImportError:
        return None
    inputs = (np.ascontiguousarray(one, dtype=np.float32) for one in (reference, image))
    error, _, _ = flip_evaluator.evaluate(*inputs, kind, inputsRGB=True, applyMagma=False)
    return np.asarray(error, dtype=np.float32).reshape(image.shape[:2])
