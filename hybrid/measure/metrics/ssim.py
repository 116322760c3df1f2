"""Structural similarity (Wang et al. 2004)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, srgb_from_radiance

# Half of SSIM's window: so far from the border the map is not defined.
SSIM_MARGIN = 5


def ssim_map(image: Image, reference: Image) -> NDArray[np.float32]:
    """(H, W) structural similarity of linear (H, W, 3) radiance, sRGB clipped to 0..1, mean of channels.

    Wang et al. 2004: 11 x 11 Gaussian window, sigma 1.5, K 0.01 and 0.03, population covariance. Valid
    SSIM_MARGIN pixels from the border inwards.
    """
    # Imported here: a frame rendered with a forest at hand need not wait for scikit-image.
    from skimage.metrics import structural_similarity

    _, full = structural_similarity(
        srgb_from_radiance(image),
        srgb_from_radiance(reference),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=2,
        full=True,
    )
    return np.asarray(full.mean(axis=2), dtype=np.float32)


def ssim(image: Image, reference: Image, weight: NDArray[np.float32] | None = None) -> float:
    """Mean of `ssim_map` over its valid region.

    Args:
        image, reference: to compare.
        weight: (H, W) of each pixel, such as a region's mask or the relative acuity; 1 by default.
    """
    return valid_mean(ssim_map(image, reference), weight)


def valid_mean(found: NDArray[np.float32], weight: NDArray[np.float32] | None = None) -> float:
    """Mean over the valid region of a map (H, W) of SSIM, of equal or so much weight (H, W)."""
    valid = np.s_[SSIM_MARGIN:-SSIM_MARGIN, SSIM_MARGIN:-SSIM_MARGIN]
    return float(np.average(found[valid], weights=None if weight is None else weight[valid]))
