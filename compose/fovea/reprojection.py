"""Samples of earlier views, reprojected to where a camera sees them now.

All views go through the same few kernels: each sample looks up the pixel in which it is visible, the samples
are sorted by pixel, and each pixel adds up its own, oldest first. So the same samples give the same sums, bit
by bit, on any number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.fovea.earlier import EarlierViews, Places
from compose.fovea.samples import Floats, Samples
from compose.fovea.surfaces import SAME_SURFACE, VisibleSurfaces
from compose.image.gloss import DIFFUSE, GLOSSY

# Cosine of how far the direction of sight may turn until a surface shows something else: 8 degrees if it is
# glossy, 0.2 degrees if it is specular. What is diffuse looks the same from everywhere.
_GLOSSY_COSINE, _SPECULAR_COSINE = np.cos(np.radians([8.0, 0.2])).tolist()
# Distance along each axis up to which two viewpoints are the same.
_SAME_VIEWPOINT = 1e-6
# As a distance, infinity.
_FARTHEST = 0x7F800000
# Floats of a pixel's sums, of which the last one is spare.
_SUMS = 8


@dataclass(frozen=True)
class Reprojected:
    """Sums over reprojected samples, for the pixels of a rectangle of a frame.

    Attributes:
        rows, columns: the rectangle.
        count: (h, w) samples.
        sums: (h, w, 6) of their radiance and of its squares.
    """

    rows: slice
    columns: slice
    count: Floats
    sums: Floats

    def at(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """(D,) counts and (D, 6) sums of pixels of the frame; 0 outside the rectangle."""
        count = np.zeros(len(row), dtype=np.float32)
        sums = np.zeros((len(row), 6), dtype=np.float32)
        inside = (row >= self.rows.start) & (row < self.rows.stop)
        inside &= (column >= self.columns.start) & (column < self.columns.stop)
        local = row[inside] - self.rows.start, column[inside] - self.columns.start
        count[inside], sums[inside] = self.count[local], self.sums[local]
        return count, sums


def reproject(views: EarlierViews, camera: Camera, new: Samples) -> Reprojected | None:
    """What earlier views contribute to a camera's view, without what no longer holds.

    Positions and directions are computed in float64: a fifth of a degree decides about mirrors, and a sample
    at the border of a pixel must not end up on its other side. Distances and sums are float32.

    Args:
        views: the earlier views.
        camera: the view.
        new: samples of it, which show the surfaces that are visible now.

    Returns:
        Sums over the rectangle around the new samples; None if there are no samples on either side.
    """
    if not views.samples or not len(new.pixels):
        return None
    surfaces = VisibleSurfaces.of(views.arrays, camera, new)
    height, width = surfaces.shape
    pixel = _visible(views.arrays, _arrivals(views, camera, surfaces), height * width)
    table = _summed(views, pixel, height * width).numpy().reshape(height, width, _SUMS)
    return Reprojected(surfaces.rows, surfaces.columns, table[..., 0], table[..., 1:7])


@dataclass(frozen=True)
class _Arrivals:
    """Where M samples of earlier views lie in a rectangle of P pixels, as Dr.Jit arrays of width M.

    Attributes:
        quarter: UInt, quarter of a pixel: four times the pixel's index, plus 0 to 3; 4 P for a sample that
            lies elsewhere, or on a surface that is not visible or looks different now.
        distance: Float, from the camera.
        certain: Bool, whether nothing can hide the sample.
    """

    quarter: Any
    distance: Any
    certain: Any


def _arrivals(views: EarlierViews, camera: Camera, surfaces: VisibleSurfaces) -> _Arrivals:
    """Samples of earlier views in the rectangle of the visible surfaces."""
    arrays, plain = views.arrays, views.arrays.plain
    height, width = surfaces.shape
    place = views.places(dr.arange(plain.UInt, views.samples))
    sight = _relative(arrays, place, [dr.opaque(plain.Float64, side) for side in camera.position.tolist()])
    across, down, inside = _quarters(arrays, sight, camera, surfaces)
    pixel = (down >> 1) * arrays.number(width) + (across >> 1)
    distance = plain.Float(dr.sqrt(_square(sight)))
    # Whatever was visible from this very position still is.
    certain, unchanged = _compared(views, place, sight, camera)
    holds = certain | (surfaces.contain(pixel, distance, place.gloss, inside) & unchanged)
    quarter = pixel << 2 | (down & 1) << 1 | across & 1
    quarter = dr.select(inside & holds, quarter, arrays.number(4 * height * width))
    dr.eval(quarter, distance, certain)
    return _Arrivals(quarter, distance, certain)


def _visible(arrays: Arrays, arrivals: _Arrivals, pixels: int) -> Any:
    """UInt (M,): pixel in which each sample is visible, or their number if something hides it."""
    UInt = arrays.plain.UInt
    # The bits of positive floats rise with their values.
    distance = dr.reinterpret_array(UInt, arrivals.distance)
    front = dr.full(UInt, _FARTHEST, 4 * pixels + 1)
    dr.scatter_reduce(dr.ReduceOp.Min, front, distance, arrivals.quarter)
    dr.eval(front)
    # Whatever lies behind something nearer in the same quarter of a pixel is hidden by it.
    nearest = dr.reinterpret_array(arrays.plain.Float, dr.gather(UInt, front, arrivals.quarter))
    seen = arrivals.certain | (arrivals.distance <= nearest * (1 + SAME_SURFACE))
    pixel = dr.select(seen, arrivals.quarter >> 2, arrays.number(pixels))
    dr.eval(pixel)
    return pixel


def _relative(arrays: Arrays, place: Places, origin: list[Any]) -> list[Any]:
    """Three Float64 (M,): vectors to places from origins, of width 1 or (M,)."""
    return [arrays.plain.Float64(at) - start for at, start in zip(place.position, origin, strict=True)]


def _quarters(
    arrays: Arrays, sight: list[Any], camera: Camera, surfaces: VisibleSurfaces
) -> tuple[Any, Any, Any]:
    """Column and row among the quarters of the rectangle's pixels, and whether it holds the sample.

    Args:
        arrays: the backend's array types.
        sight: three Float64 (M,), from the camera to the samples, in the world.
        camera: the view.
        surfaces: of the rectangle.
    """
    plain = arrays.plain
    number = lambda value: dr.opaque(plain.Float64, float(value))  # noqa: E731
    x, y, depth = (
        sum(number(entry) * side for entry, side in zip(row, sight, strict=True))
        for row in camera.world_to_camera[:3, :3]
    )
    inside = depth > 0
    found = []
    for position, focal, middle, side in (
        (x, camera.fx, camera.cx, surfaces.columns),
        (y, camera.fy, camera.cy, surfaces.rows),
    ):
        quarter = 2 * (number(focal) * position / depth + number(middle)) - number(2 * side.start)
        inside &= (quarter >= 0) & (quarter < number(2 * (side.stop - side.start)))
        found.append(quarter)
    # Numbers that an integer does not hold are not converted.
    across, down = (plain.UInt(dr.select(inside, quarter, 0)) for quarter in found)
    return across, down, inside


def _compared(views: EarlierViews, place: Places, sight: list[Any], camera: Camera) -> tuple[Any, Any]:
    """Whether samples come from this very viewpoint, and whether their surface looks the same from here.

    Args:
        views: the earlier views.
        place: of M samples.
        sight: three Float64 (M,), from the camera to the samples, in the world.
        camera: the view.
    """
    plain, viewpoints = views.arrays.plain, views.viewpoints()
    same = (np.abs(viewpoints - camera.position) < _SAME_VIEWPOINT).all(axis=1)
    table = views.arrays.uploaded(plain.Float64, np.column_stack([viewpoints, same]))
    *origin, certain = dr.gather(plain.ArrayXf64, table, place.view, shape=(4, dr.width(place.view)))
    before = _relative(views.arrays, place, origin)
    cosine = sum(a * b for a, b in zip(before, sight, strict=True))
    least = dr.select(place.gloss == GLOSSY, plain.Float64(_GLOSSY_COSINE), _SPECULAR_COSINE)
    unturned = cosine >= least * dr.sqrt(_square(before) * _square(sight))
    return certain > 0, (place.gloss == DIFFUSE) | unturned


def _summed(views: EarlierViews, pixel: Any, pixels: int) -> Any:
    """Flat Float of sums: for each pixel the count, the six sums of light, and 0.

    Args:
        views: the earlier views, with M samples.
        pixel: UInt (M,), pixel in which each is visible, or `pixels`.
        pixels: number of pixels.
    """
    arrays, UInt, Float = views.arrays, views.arrays.plain.UInt, views.arrays.plain.Float
    order = arrays.argsort(pixel, pixels + 1)
    starts, ends = _runs(arrays, pixel, pixels, order)
    target = dr.arange(UInt, pixels)
    start, end = dr.gather(UInt, starts, target), dr.gather(UInt, ends, target)

    def add(i: Any, sums: list[Any]) -> tuple[Any, list[Any]]:
        more = views.lights(dr.gather(UInt, order, i))
        return i + 1, [one + other for one, other in zip(sums, more, strict=True)]

    # Built one by one: [Float(0)] * n would be a single accumulator n times.
    nothing = [Float(0) for _ in range(_SUMS)]
    _, sums = dr.while_loop((start, nothing), lambda i, sums: i < end, add, mode="symbolic")
    # Evaluated before they are scattered: otherwise the scatter runs the loop again.
    dr.eval(sums)
    table = dr.empty(Float, _SUMS * pixels)
    dr.scatter(table, arrays.plain.ArrayXf(sums), target, mode=dr.ReduceMode.Permute)
    dr.eval(table)
    return table


def _runs(arrays: Arrays, pixel: Any, pixels: int, order: Any) -> tuple[Any, Any]:
    """UInts (pixels + 1,): start and end of each pixel's samples in an order by pixel."""
    UInt, count = arrays.plain.UInt, dr.width(order)
    index, last = dr.arange(UInt, count), arrays.number(count - 1)
    at = lambda i: dr.gather(UInt, pixel, dr.gather(UInt, order, i))  # noqa: E731
    here, before = at(index), at(dr.maximum(index, 1) - 1)
    changes = here != before
    start, end = dr.zeros(UInt, pixels + 1), dr.zeros(UInt, pixels + 1)
    # A pixel of which the run starts at 0 keeps the 0 that is there.
    dr.scatter(start, index, here, changes, mode=dr.ReduceMode.Permute)
    dr.scatter(end, index, before, changes, mode=dr.ReduceMode.Permute)
    dr.scatter(end, index + 1, here, index == last, mode=dr.ReduceMode.Permute)
    dr.eval(start, end)
    return start, end


def _square(vector: list[Any]) -> Any:
    return sum(side * side for side in vector)
