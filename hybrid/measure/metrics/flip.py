"""FLIP (Andersson et al. 2020) and HDR-FLIP (Andersson et al. 2021), where they are installed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, srgb_from_radiance


def flip_map(image: Image, reference: Image) -> NDArray[np.float32] | None:
    """(H, W) FLIP of two pictures in linear radiance, shown at 67 pixels per degree; 0 for no difference.

    Returns:
        The error in 0..1, None where the metric is not installed.
    """
    return _evaluated(srgb_from_radiance(image), srgb_from_radiance(reference), "LDR")


def hdr_flip_map(image: Image, reference: Image) -> NDArray[np.float32] | None:
    """(H, W) HDR-FLIP: the largest FLIP over a range of exposures, which the reference alone decides.

    Returns:
        The error in 0..1, None where the metric is not installed.
    """
    return _evaluated(image, reference, "HDR")


def flip(image: Image, reference: Image) -> float | None:
    """Mean of `flip_map`, None where the metric is not installed."""
    found = flip_map(image, reference)
    return None if found is None else float(found.mean())


def _evaluated(image: Image, reference: Image, kind: str) -> NDArray[np.float32] | None:
    try:
        import flip_evaluator
    except ImportError:
        return None
    inputs = (np.ascontiguousarray(picture, dtype=np.float32) for picture in (reference, image))
    found, _, _ = flip_evaluator.evaluate(*inputs, kind, inputsRGB=True, applyMagma=False)
    return np.asarray(found, dtype=np.float32).reshape(image.shape[:2])
