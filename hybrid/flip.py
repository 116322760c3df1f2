"""FLIP (Andersson et al. 2020), where it is installed."""

from __future__ import annotations

from compose.blend import Image, srgb_from_radiance


def flip(image: Image, reference: Image) -> float | None:
    """Mean FLIP of two pictures (H, W, 3) in linear radiance, shown at 67 pixels per degree; 0 for none.

    Returns:
        The error in 0..1, None where the metric is not installed.
    """
    try:
        import flip_evaluator
    except ImportError:
        return None
    pictures = srgb_from_radiance(reference), srgb_from_radiance(image)
    _, mean, _ = flip_evaluator.evaluate(*pictures, "LDR", inputsRGB=True, applyMagma=False)
    return float(mean)
