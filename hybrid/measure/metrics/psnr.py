"""Peak signal-to-noise ratio."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.image.colour import Image, srgb_from_radiance
from hybrid.measure.metrics.pair import checked_pair

# Smaller errors count as this one, so that equal images have 120 dB instead of infinitely many.
_LEAST_ERROR = 1e-12


def psnr(image: Image, reference: Image, where: NDArray[np.bool_] | None = None) -> float:
    """Peak signal-to-noise ratio in dB, of sRGB values clipped to 0..1; at most 120.

    Args:
        image, reference: (..., 3) linear radiance.
        where: (...) pixels that count; all of them if None.

    Raises:
        UserError: the two cannot be compared, or no pixel counts.
    """
    checked_pair(image, reference)
    squares = (srgb_from_radiance(image) - srgb_from_radiance(reference)) ** 2
    return psnr_of_error(np.mean(squares if where is None else squares[where], dtype=np.float64))


def psnr_of_error(squared_error: float) -> float:
    """Peak signal-to-noise ratio in dB of a mean squared error of values in 0..1; at most 120.

    Raises:
        UserError: the error is not finite.
    """
    if not np.isfinite(squared_error):
        raise UserError(f"squared error {squared_error}: must be finite to have a PSNR")
    return float(-10 * np.log10(max(squared_error, _LEAST_ERROR)))
