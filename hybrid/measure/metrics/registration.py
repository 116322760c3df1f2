"""Whether two images of one view line up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, luminance, srgb_from_radiance
from hybrid.measure.metrics.pair import checked_pair

# Side in pixels of the windows in which the shift is measured, and steps per pixel.
_WINDOW = 64
_UPSAMPLING = 50
# A window counts as textured if its luminance (sRGB) has at least this standard deviation.
_TEXTURE = 0.05
# The image itself must show some of it: a flat window would count as perfectly aligned.
_LEAST_TEXTURE = 0.01
# Share of a window's pixels that must be among those that count.
_LEAST_SHARE = 0.25


def registration_px(image: Image, reference: Image, where: NDArray[np.bool_] | None = None) -> float | None:
    """Median shift in pixels between two images (H, W, 3) of one view, over their textured windows.

    Phase correlation in windows of 64 x 64 pixels, to 1/50 px (Guizar-Sicairos et al. 2008).

    Args:
        image, reference: linear radiance.
        where: (H, W) pixels of which a window must hold a quarter; all windows count if None.

    Returns:
        The shift; None if no window of both has enough texture to tell.

    Raises:
        UserError: the two images cannot be compared.
    """
    checked_pair(image, reference)
    from skimage.registration import phase_cross_correlation

    first, second = (luminance(srgb_from_radiance(one)) for one in (image, reference))
    taper = np.outer(np.hanning(_WINDOW), np.hanning(_WINDOW))
    shifts = []
    for top in range(0, first.shape[0] - _WINDOW + 1, _WINDOW // 2):
        for left in range(0, first.shape[1] - _WINDOW + 1, _WINDOW // 2):
            box = np.s_[top : top + _WINDOW, left : left + _WINDOW]
            if where is not None and where[box].mean() < _LEAST_SHARE:
                continue
            a, b = first[box], second[box]
            if b.std() < _TEXTURE or a.std() < _LEAST_TEXTURE:
                continue
            shift, _, _ = phase_cross_correlation(
                (b - b.mean()) * taper,
                (a - a.mean()) * taper,
                upsample_factor=_UPSAMPLING,
                normalization=None,
            )
            shifts.append(float(np.hypot(*shift)))
    return float(np.median(shifts)) if shifts else None
