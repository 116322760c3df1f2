"""Distortion by a lens, and images without it.

The model is that of Nerfies' cameras, and of OpenCV: three radial and two tangential coefficients, and skew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from compose.camera.camera import Camera

Array = NDArray[np.float64]
# Share of a frame's pixels that must be left once what the lens did not show is cut off.
_LEAST_LEFT = 0.5
# Pixels beyond the border that are taken for the border itself.
_TOLERANCE = 0.5


@dataclass(frozen=True)
class Lens:
    """How a lens distorts.

    Attributes:
        radial: k1, k2 and k3.
        tangential: p1 and p2.
        skew: pixels to the right per unit downwards on the image plane.
    """

    radial: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)
    skew: float = 0.0

    @property
    def distorts(self) -> bool:
        """Whether it does anything at all."""
        return any((*self.radial, *self.tangential, self.skew))

    def distorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Where points of the image plane at depth 1 appear on it."""
        (k1, k2, k3), (p1, p2) = self.radial, self.tangential
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
        )


def undistorted(camera: Camera, lens: Lens, images: Sequence[Array]) -> tuple[Camera, list[Array]]:
    """Images as a camera without a lens would show them, without the margin that the lens did not show.

    Args:
        camera: the view without distortion, at the size of the images.
        lens: what they were taken with.
        images: (H, W) each.

    Returns:
        The camera of the remaining rectangle, and (H', W') of each image in it, by cubic splines.

    Raises:
        ValueError: the distortion is too strong: it folds, or leaves less than half of the frame.
    """
    # Lenses of damaged files overflow, and are refused.
    with np.errstate(over="ignore", invalid="ignore"):
        x, y = _sources(camera, lens)
        rectangle = _valid_rectangle(camera, x, y)
    rows, columns = rectangle
    left = (rows.stop - rows.start) * (columns.stop - columns.start)
    if left < _LEAST_LEFT * x.size or _folds(x[rectangle], y[rectangle]):
        raise ValueError(
            f"distortion {[*lens.radial, *lens.tangential]} is too strong for an image of "
            f"{camera.width} x {camera.height} pixels; undistort the images first"
        )
    at = np.stack([y[rectangle], x[rectangle]])
    cut = camera.cropped(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
    return cut, [map_coordinates(image, at, order=3, mode="nearest") for image in images]


def _sources(camera: Camera, lens: Lens) -> tuple[Array, Array]:
    """(H, W) columns and rows, counted from 0, where the image shows what an undistorted pixel does."""
    centres = camera.pixel_centres()
    x, y = (centres[:, 0] - camera.cx) / camera.fx, (centres[:, 1] - camera.cy) / camera.fy
    x, y = lens.distorted(x, y)
    shape = camera.height, camera.width
    across = camera.fx * x + lens.skew * y + camera.cx - 0.5
    down = camera.fy * y + camera.cy - 0.5
    return across.reshape(shape), down.reshape(shape)


def _valid_rectangle(camera: Camera, x: Array, y: Array) -> tuple[slice, slice]:
    """Rows and columns left when sides that the image does not show are cut off, the worst one first."""
    shown = (np.abs(2 * x - (camera.width - 1)) <= camera.width - 1 + 2 * _TOLERANCE) & (
        np.abs(2 * y - (camera.height - 1)) <= camera.height - 1 + 2 * _TOLERANCE
    )
    # What is not a number is not shown, either.
    missed = ~shown
    top, bottom, left, right = 0, camera.height, 0, camera.width
    while top < bottom and left < right and missed[top:bottom, left:right].any():
        inner = missed[top:bottom, left:right]
        shares = [side.mean() for side in (inner[0], inner[-1], inner[:, 0], inner[:, -1])]
        worst = int(np.argmax(shares))
        # A hole amid the frame is no margin: cutting goes on until little is left, which is refused.
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    return slice(top, bottom), slice(left, right)


def _folds(x: Array, y: Array) -> bool:
    """Whether neighbours change places somewhere."""
    if min(x.shape) < 2:
        return False
    (x_down, x_across), (y_down, y_across) = np.gradient(x), np.gradient(y)
    return bool((x_across * y_down - x_down * y_across <= 0).any())
