"""A finished image as another camera sees it, from depths of what it shows: for viewers who moved meanwhile.

Each cell of the new view searches the image for the surface that it shows, then each pixel looks up its
colour: looking backwards leaves no cracks. A guess of the depth says where in the image it would lie; the
depth that is known there is the next guess (Bowles et al. 2012, "Iterative Image Warping"). The search
converges on surfaces that the image shows. Begun at several depths, it finds those that hide each other, and
the nearest one is seen. Where none converges, something has come into view from behind something else; there,
the cell shows the farthest surface that it met, which is the background beside what had hidden it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from compose.base.frozen import Frozen
from compose.camera.camera import Camera
from compose.image.device_image import DeviceImage, bilinear_taps

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

# Side of cells in pixels. One ray for each takes 3 ms for a frame of 640 x 480 on two cores; with cells of 8
# pixels 1.5 ms, and 1.5 dB worse where a viewer steps aside (`room`).
CELL = 4
# Ratio of inverse depths from which on two neighbouring cells show different surfaces.
_EDGE = 1.2
# Depths at which the search begins, from the nearest one to infinity, and its steps from each.
_STARTS, _STEPS = 4, 4
# Pixels by which the nearest of these may move against what is infinitely far away: with one thing right
# before the camera, hardly any would be left for all others.
_REACH = 64.0
# Pixels by which the last step of a search that has converged may move.
_CONVERGED = 1.0
# Least depth, over that of an axis of length 1: what is beside or behind a camera lies beyond its frame.
_LEAST = 1e-4


def grid(camera: Camera) -> tuple[int, int]:
    """Rows and columns of cells, which cover a camera's frame."""
    return -(-camera.height // CELL), -(-camera.width // CELL)


@dataclass(frozen=True)
class _Views:
    """Where points of a view lie in an image of another one; all are of width 1."""

    turn: list[list[Float]]  # 3 x 3, takes pixels of the view to those of the image
    aside: list[Float]  # three: how a point at depth 1 moves, since the viewpoints are not the same
    nearest: Float  # greatest inverse depth at which a search begins
    width: UInt  # of both frames
    height: UInt
    columns: UInt  # of the cells
    rows: UInt

    @staticmethod
    def of(arrays: Arrays, camera: Camera, newest: Camera) -> _Views:
        own, other = (
            np.array([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1]]) for view in (camera, newest)
        )
        moved = camera.world_to_camera @ newest.camera_to_world
        turn = own @ moved[:3, :3] @ np.linalg.inv(other)
        fastest = max(camera.fx, camera.fy) * float(np.linalg.norm(moved[:3, 3]))
        numbers = [*turn.ravel(), *own @ moved[:3, 3], _REACH / max(fastest, _LEAST)]
        numbers = arrays.scalars(arrays.plain.Float, numbers)
        *turned, aside = (numbers[k : k + 3] for k in range(0, 12, 3))
        sizes = map(arrays.constant, (camera.width, camera.height, *reversed(grid(camera))))
        return _Views(turned, aside, numbers[12], *sizes)


class _Sight:
    """Lines of sight of a view through positions in pixels, Floats (N,), as they run through the image."""

    def __init__(self, views: _Views, x: Float, y: Float):
        self._views = views
        self._far = [dr.fma(a, x, dr.fma(b, y, c)) for a, b, c in views.turn]

    def at(self, nearness: Float) -> tuple[Float, Float]:
        """Position in the image, in pixels, of what is at inverse depths in the view."""
        x, y, z = (dr.fma(nearness, a, f) for a, f in zip(self._views.aside, self._far, strict=True))
        z = dr.maximum(z, _LEAST)
        return x / z, y / z

    def seen_at(self, nearness: Float) -> Float:
        """Inverse depth in the view of what has another one in the image."""
        return nearness * self._far[2] / dr.maximum(1 - nearness * self._views.aside[2], _LEAST)


def warped(image: DeviceImage, nearness: Float, camera: Camera, newest: Camera) -> DeviceImage:
    """An image of a camera's view as the newest camera sees it; the image itself if the two are equal.

    What lies beyond the image, whose values are all finite, continues its border. `nearness` (rows *
    columns,) is the inverse depth along the view axis, 0 or more, of what the camera sees at the centres of
    the cells of its `grid`, in units of the cameras' positions. ValueError if sizes do not fit.
    """
    arrays, size = image.arrays, (camera.width, camera.height)
    rows, columns = grid(camera)
    if newest == camera:
        return image
    if not size == (newest.width, newest.height) == (image.width, image.height):
        raise ValueError(f"an image of {image.width} x {image.height}, cameras of {size} and another size")
    if dr.width(nearness) != rows * columns:
        raise ValueError(f"{dr.width(nearness)} depths, must be {rows} x {columns}")
    if not image.is_whole:
        image = image.packed()
    views, stride = _Views.of(arrays, camera, newest), arrays.constant(image.stride)
    flat = _warped(arrays, views, nearness, image.values, stride, image.channels, size[0] * size[1])
    return DeviceImage(arrays, flat, *size, size[0])


def warped_values(
    arrays: Arrays, views: _Views, nearness: Float, values: Float, stride: UInt, channels: int, count: int
) -> Float:
    """Float (3 count,), all pixels of the view, row by row."""
    plain = arrays.plain
    outlined = _outlined(arrays, views, nearness)
    dr.eval(outlined)
    found = _found(arrays, views, outlined)
    dr.eval(found)
    row = dr.arange(plain.UInt, count) // views.width
    column = dr.arange(plain.UInt, count) - row * views.width
    x, y = plain.Float(column) + 0.5, plain.Float(row) + 0.5
    taps = bilinear_taps(arrays, x * (1 / CELL), y * (1 / CELL), views.columns, views.rows)
    own = dr.sum([weight * dr.gather(plain.Float, found, i * views.columns + j) for i, j, weight in taps])
    total = [plain.Float(0) for _ in range(3)]
    for i, j, weight in bilinear_taps(arrays, *_Sight(views, x, y).at(own), views.width, views.height):
        first = (i * stride + j) * channels
        for c in range(3):
            total[c] = dr.fma(weight, dr.gather(plain.Float, values, first + c), total[c])
    flat: Float = plain.Float(dr.ravel(plain.Array3f(*total)))
    dr.eval(flat)
    return flat


_warped = Frozen(warped_values, by_size=True)


def _outlined(arrays: Arrays, views: _Views, nearness: Float) -> Float:
    """Inverse depths of cells in which those beside something nearer count as that.

    It keeps its outline then, with a rim of what surrounds it, though cells are larger than pixels.
    """
    plain = arrays.plain
    cell = dr.arange(plain.UInt, dr.width(nearness))
    row = plain.Int(cell // views.columns)
    column = plain.Int(cell) - row * plain.Int(views.columns)
    nearest = nearness
    for k in range(9):
        i = dr.clip(row + (k // 3 - 1), 0, plain.Int(views.rows) - 1)
        j = dr.clip(column + (k % 3 - 1), 0, plain.Int(views.columns) - 1)
        beside = dr.gather(plain.Float, nearness, plain.UInt(i) * views.columns + plain.UInt(j))
        nearest = dr.maximum(nearest, beside)
    return dr.select(nearest > _EDGE * nearness, nearest, nearness)


def _found(arrays: Arrays, views: _Views, nearness: Float) -> Float:
    """Float (rows * columns,), inverse depth of what is seen at the centre of each cell of the view."""
    plain = arrays.plain
    cell = dr.arange(plain.UInt, dr.width(nearness))
    row = cell // views.columns
    centre = (plain.Float(cell - row * views.columns) + 0.5) * CELL, (plain.Float(row) + 0.5) * CELL
    sight = _Sight(views, *centre)
    nearest, seen = dr.minimum(dr.max(nearness), views.nearest), plain.Float(-1)
    for start in range(_STARTS):
        own = sight.seen_at(nearest * (1 - start / (_STARTS - 1)))
        position = sight.at(own)
        least, background, move = plain.Float(dr.inf), own, plain.Float(dr.inf)
        for _ in range(_STEPS):
            j, i = (
                plain.UInt(dr.clip(at * (1 / CELL), 0, plain.Float(end) - 1))
                for at, end in zip(position, (views.columns, views.rows), strict=True)
            )
            there = dr.gather(plain.Float, nearness, i * views.columns + j)
            farther = there < least
            least = dr.select(farther, there, least)
            background = dr.select(farther, own, background)
            own, before = sight.seen_at(there), position
            position = sight.at(own)
            move = dr.maximum(*(dr.abs(a - b) for a, b in zip(position, before, strict=True)))
        seen = dr.select(move < _CONVERGED, dr.maximum(seen, own), seen)
    # The last search began at infinity: what it met lies beside what hides the background.
    return dr.select(seen < 0, background, seen)
