"""The regions of a frame for which quality is measured separately."""

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
from compose.image.colour import Image

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
