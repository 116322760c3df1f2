"""How alike two images are: PSNR, SSIM (Wang et al. 2004), whether they line up, and in which regions.

Images are linear radiance. All metrics raise UserError if the two cannot be compared (`checked_pair`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom

from compose.base.errors import UserError
from compose.eye.detail import saliency
from compose.eye.gaze import Gaze, require_within_frame
from compose.fovea.foveation import Foveation
from compose.image.colour import Image, decibels, luminance, srgb_from_radiance


def checked_pair(image: Image, reference: Image, name: str = "the image") -> None:
    """Checks that two images (..., 3) can be compared; the name is that of the first in messages.

    UserError if their sizes differ, they have no pixels, or one has a pixel that is not finite: some metrics
    would ignore it and others would yield NaN, neither of which is a figure.
    """
    if image.shape != reference.shape:
        raise UserError(
            f"{name} is {_size(image)} pixels, its reference {_size(reference)}: they cannot be compared"
        )
    if image.size == 0:
        raise UserError(f"{name} has no pixels: it cannot be compared")
    for one, what in ((image, name), (reference, f"the reference of {name}")):
        bad = int(np.count_nonzero(~np.isfinite(one).all(axis=-1)))
        if bad:
            raise UserError(f"{what} has {bad} pixels that are not finite: it cannot be compared")


def _size(image: Image) -> str:
    return " x ".join(str(side) for side in reversed(image.shape[:-1]))


def psnr(image: Image, reference: Image, where: NDArray[np.bool_] | None = None) -> float:
    """Peak signal-to-noise ratio in dB of images (..., 3), as sRGB clipped to 0..1; at most 120.

    If `where` (...) is given, only the pixels count where it is true; UserError if no pixel counts.
    """
    checked_pair(image, reference)
    squares = (srgb_from_radiance(image) - srgb_from_radiance(reference)) ** 2
    return psnr_of_error(np.mean(squares if where is None else squares[where], dtype=np.float64))


def psnr_of_error(squared_error: float) -> float:
    """PSNR in dB, at most 120, of a mean squared error of values in 0..1; UserError if not finite."""
    if not np.isfinite(squared_error):
        raise UserError(f"squared error {squared_error}: must be finite to have a PSNR")
    return decibels(squared_error)


# Half the side of SSIM's window: the map is undefined this close to the border.
SSIM_MARGIN = 5
# Its side: smaller images have no pixel with a valid value.
SSIM_WINDOW = 2 * SSIM_MARGIN + 1
_VALID = np.s_[SSIM_MARGIN:-SSIM_MARGIN, SSIM_MARGIN:-SSIM_MARGIN]


def ssim_map(image: Image, reference: Image) -> NDArray[np.float32]:
    """(H, W) SSIM of images (H, W, 3) as sRGB clipped to 0..1, mean of the channels.

    As in Wang et al. 2004: 11 x 11 Gaussian window, sigma 1.5, K 0.01 and 0.03, population covariance. Valid
    from SSIM_MARGIN pixels inside the border on. UserError if a side is smaller than SSIM_WINDOW.
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
    """`valid_mean` of `ssim_map`; a weight may be a region's mask, or the relative acuity."""
    return valid_mean(ssim_map(image, reference), weight)


def valid_mean(similarity: NDArray[np.float32], weight: NDArray[np.float32] | None = None) -> float:
    """Mean of an SSIM map (H, W), weighted by (H, W) or equally; UserError if no valid pixel has weight."""
    if weight is not None and not has_valid(weight):
        raise UserError(f"SSIM: every pixel that counts is within {SSIM_MARGIN} pixels of the border")
    return float(np.average(similarity[_VALID], weights=None if weight is None else weight[_VALID]))


def has_valid(weight: NDArray[np.float32]) -> bool:
    """Whether any pixel that has a weight, (H, W), has a valid SSIM."""
    return bool(np.any(weight[_VALID] > 0))


def quality(image: Image, reference: Image) -> dict[str, float]:
    """PSNR and SSIM, under the names that all reports use."""
    return {"psnr": psnr(image, reference), "ssim": ssim(image, reference)}


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

    Phase correlation in windows of 64 x 64 pixels, to 1/50 px (Guizar-Sicairos et al. 2008). If `where`
    (H, W) is given, it must be true in a quarter of a window. None if no window of both images has enough
    texture to tell.
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
            inputs = ((window - window.mean()) * taper for window in (b, a))
            shift, _, _ = phase_cross_correlation(*inputs, upsample_factor=_UPSAMPLING, normalization=None)
            shifts.append(float(np.hypot(*shift)))
    return float(np.median(shifts)) if shifts else None


# In the order of all tables.
REGIONS = ("whole", "foveal", "seam", "peripheral", "salient")
# Quantile of saliency above which pixels belong to the salient region.
_SALIENT_ABOVE = 0.8
# Side in pixels of the image in which saliency is computed.
_COARSE = 64


@dataclass(frozen=True)
class ImageRegion:
    """Some pixels (H, W) of a frame, named as in REGIONS, and rows and columns of the box around them."""

    name: str
    mask: NDArray[np.bool_]
    box: tuple[slice, slice]

    @staticmethod
    def of(name: str, mask: NDArray[np.bool_]) -> ImageRegion:
        """The region of a mask (H, W); UserError if that is empty."""
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if not len(rows):
            raise UserError(f"the {name} region of this frame is empty: nothing can be measured there")
        box = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
        return ImageRegion(name, mask, box)

    def alone(self, image: Image, reference: Image) -> Image:
        """(H, W, 3) the image inside the region, the reference outside, so that no other error counts."""
        return np.where(self.mask[..., None], image, reference)

    def gaze_within(self, gaze: Gaze) -> Gaze:
        """A gaze in fractions of the frame, in fractions of the box."""
        height, width = self.mask.shape
        x, y = gaze.pixel(width, height)
        rows, columns = self.box
        across, down = columns.stop - columns.start, rows.stop - rows.start
        return Gaze((x - columns.start) / across, (y - rows.start) / down)


def regions(foveation: Foveation, reference: Image) -> dict[str, ImageRegion]:
    """All regions of a frame with a reference (H, W, 3), by name.

    These are the whole frame; the foveal disc inside fov-a, band included; the seam, which is the band from
    fov-b to fov-a; the periphery outside fov-a; and the salient fifth of the reference. UserError if the gaze
    lies outside the frame, or if a region is empty.
    """
    height, width = reference.shape[:2]
    plain = plain_regions(foveation, (height, width))
    step = max(1, max(height, width) // _COARSE)
    rows, columns = height // step, width // step
    coarse = reference[: rows * step, : columns * step].reshape(rows, step, columns, step, 3).mean((1, 3))
    found = zoom(saliency(coarse.astype(np.float32)), (height / rows, width / columns), order=1)
    salient = np.asarray(found > np.quantile(found, _SALIENT_ABOVE))
    return {**plain, "salient": ImageRegion.of("salient", salient)}


def plain_regions(
    foveation: Foveation, size: tuple[int, int], wanted: Sequence[str] = REGIONS[:-1]
) -> dict[str, ImageRegion]:
    """The regions that depend on foveation alone, by name, of a frame of that height and width.

    The seam is left out if it has no width, and so are seam and periphery if the disc covers the frame.
    UserError if the gaze lies outside the frame, or if a wanted region is empty.
    """
    gaze = foveation.gaze
    require_within_frame(gaze.x, gaze.y)
    height, width = size
    x, y = gaze.pixel(width, height)
    radius = np.hypot(np.arange(width)[None, :] + 0.5 - x, np.arange(height)[:, None] + 0.5 - y)
    outer, inner = (percent / 100 * height for percent in (foveation.fov_a, foveation.fov_b))
    masks = {
        "whole": np.ones((height, width), dtype=bool),
        "foveal": radius < outer,
        "seam": (radius >= inner) & (radius < outer),
        "peripheral": radius >= outer,
    }
    # Settings that ask for such a frame are not mistaken, unlike a disc without a pixel.
    left_out = {"seam"} if outer == inner else set()
    if masks["foveal"].all():
        left_out |= {"peripheral", "seam"}
    return {
        name: ImageRegion.of(name, mask) for name, mask in masks.items() if name in set(wanted) - left_out
    }
