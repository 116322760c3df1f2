"""Structural similarity (SSIM, Wang et al. 2004)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.image.colour import Image, srgb_from_radiance
from hybrid.measure.metrics.pair import checked_pair

# Half the side of SSIM's window: the map is undefined this close to the border.
SSIM_MARGIN = 5
# Its side: smaller images have no pixel with a valid value.
SSIM_WINDOW = 2 * SSIM_MARGIN + 1
_VALID = np.s_[SSIM_MARGIN:-SSIM_MARGIN, SSIM_MARGIN:-SSIM_MARGIN]


def ssim_map(image: Image, reference: Image) -> NDArray[np.float32]:
    """(H, W) SSIM of linear radiance (H, W, 3) as sRGB clipped to 0..1, mean of the channels.

    As in Wang et al. 2004: 11 x 11 Gaussian window, sigma 1.5, K 0.01 and 0.03, population covariance. Valid
    from SSIM_MARGIN pixels inside the border on.

    Raises:
        UserError: the two images cannot be compared, or are smaller than SSIM_WINDOW along an axis.
    """
    checked_pair(image, reference)
    if min(image.shape[:2]) < SSIM_WINDOW:
        raise UserError(
            f"SSIM of {image.shape[1]} x {image.shape[0]} pixels: "
            f"must be at least {SSIM_WINDOW} x {SSIM_WINDOW}"
        )
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

    Raises:
        UserError: as of `ssim_map` and `valid_mean`.
    """
    return valid_mean(ssim_map(image, reference), weight)


def valid_mean(similarity: NDArray[np.float32], weight: NDArray[np.float32] | None = None) -> float:
    """Mean of an SSIM map (H, W) over its valid pixels, weighted by (H, W) or equally.

    Raises:
        UserError: no valid pixel has any weight.
    """
    if weight is not None and not has_valid(weight):
        raise UserError(f"SSIM: every pixel that counts is within {SSIM_MARGIN} pixels of the border")
    return float(np.average(similarity[_VALID], weights=None if weight is None else weight[_VALID]))


def has_valid(weight: NDArray[np.float32]) -> bool:
    """Whether any pixel that has a weight, (H, W), has a valid SSIM."""
    return bool(np.any(weight[_VALID] > 0))
