"""Structural similarity (SSIM, Wang et al. 2004)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, srgb_from_radiance

# Half the side of SSIM's window: the map is undefined this close to the border.
SSIM_MARGIN = 5


def ssim_map(image: Image, reference: Image) -> NDArray[np.float32]:
    """(H, W) SSIM of linear radiance (H, W, 3) as sRGB clipped to 0..1, mean of the channels.

    As in Wang et al. 2004: 11 x 11 Gaussian window, sigma 1.5, K 0.01 and 0.03, population covariance. Valid
    from SSIM_MARGIN pixels inside the border on.
    """
    # Imported here because rendering a frame must not wait for scikit-image.
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
    """Mean of `ssim_map` over its valid pixels.

    Args:
        image, reference: (H, W, 3) linear radiance.
        weight: (H, W) weight of each pixel, such as a region's mask or the relative acuity; 1 if None.
    """
    return valid_mean(ssim_map(image, reference), weight)


def valid_mean(similarity: NDArray[np.float32], weight: NDArray[np.float32] | None = None) -> float:
    """Mean of an SSIM map (H, W) over its valid pixels, weighted by (H, W) or equally."""
    valid = np.s_[SSIM_MARGIN:-SSIM_MARGIN, SSIM_MARGIN:-SSIM_MARGIN]
    return float(np.average(similarity[valid], weights=None if weight is None else weight[valid]))
