"""Samples of earlier views, reprojected to where a camera sees them now, if they lie on visible surfaces.

All views go through the same few kernels: each sample looks up the pixel in which it is visible, the samples
are sorted by pixel, and each pixel adds up its own, oldest first. So the same samples give the same sums, bit
by bit, on any number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays, uploaded
from compose.base.traced_samples import DIFFUSE, GLOSSY, SPECULAR, UNSTEADY
from compose.camera.camera import Camera
from compose.fovea.earlier_views import EarlierViews, Places
from compose.fovea.samples import RECORD, Samples

# Relative difference of distances up to which two hits are taken for the same surface.
SAME_SURFACE = 0.005
# Floats of a pixel that has been sampled, and of the surfaces around a pixel.
_SAMPLED, _AROUND = 2, 4


@dataclass(frozen=True)
class VisibleSurfaces:
    """The surfaces that samples of a view hit, around each pixel of the rectangle in which these lie.

    Attributes:
        arrays: the backend's array types.
        rows, columns: the rectangle.
        table: flat Float, for each of its pixels, row by row: the least and the greatest distance at which a
            surface may be that is visible in it or in the eight around it; 1 if the pixel itself shows
            something that mirrors or refracts, else 0; and 0.
    """

    arrays: Arrays
    rows: slice
    columns: slice
    table: Any

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w), the number of rows and columns."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    @staticmethod
    def of(arrays: Arrays, camera: Camera, new: Samples, box: tuple[slice, slice]) -> VisibleSurfaces:
        """The surfaces that samples of a camera's view hit, at least one sample.

        Args:
            arrays: the backend's array types.
            camera: the view.
            new: the samples.
            box: rows and columns in which all of these lie.
        """
        rows, columns = box
        height, width = rows.stop - rows.start, columns.stop - columns.start
        # A frame of one pixel around the rectangle spares its edges a test.
        row = new.pixels // arrays.constant(camera.width)
        column = new.pixels - row * arrays.constant(camera.width)
        corner = arrays.constant(rows.start), arrays.constant(columns.start)
        target = (row - corner[0] + 1) * arrays.constant(width + 2) + (column - corner[1] + 1)
        sampled = _sampled(arrays, camera, new, target, (height + 2) * (width + 2))
        return VisibleSurfaces(arrays, rows, columns, _around(arrays, sampled, height, width))

    def contain(self, pixel: Any, distance: Any, gloss: Any, active: Any) -> Any:
        """Whether hits lie on these surfaces.

        Args:
            pixel: UInt (M,), index of a pixel of the rectangle.
            distance: Float (M,), from the camera.
            gloss: UInt (M,), class of gloss of what is hit.
            active: Bool (M,), the hits in question.
        """
        around = dr.gather(
            self.arrays.plain.ArrayXf, self.table, pixel, active, shape=(_AROUND, dr.width(pixel))
        )
        same = active & (distance >= around[0]) & (distance <= around[1])
        # Specular objects are thin in places, and what is visible beside them is far behind them.
        return same & ((around[2] == 0) | (gloss == SPECULAR))


def _sampled(arrays: Arrays, camera: Camera, new: Samples, target: Any, size: int) -> Any:
    """Flat Float of `size` pixels: distance of what a sample hits, or -1; and 1 if that is specular."""
    plain = arrays.plain
    eye = [dr.opaque(plain.Float64, value) for value in camera.position.tolist()]
    sight = [plain.Float64(at) - origin for at, origin in zip(new.position, eye, strict=True)]
    distance = plain.Float(dr.sqrt(sum(side * side for side in sight)))
    specular = dr.select(new.gloss == SPECULAR, plain.Float(1), 0)
    table = dr.full(plain.Float, -1, _SAMPLED * size)
    values = plain.ArrayXf([distance, specular])
    dr.scatter(table, values, target, mode=dr.ReduceMode.Permute)
    dr.eval(table)
    return table


def _around(arrays: Arrays, sampled: Any, height: int, width: int) -> Any:
    """Table of the surfaces around each pixel, from that of the pixels and of a frame around them."""
    plain = arrays.plain
    index, across, stride = (
        dr.arange(plain.UInt, height * width),
        arrays.constant(width),
        arrays.constant(width + 2),
    )
    row = index // across
    corner = row * stride + (index - row * across)
    nearest, farthest = plain.Float(np.inf), plain.Float(0)
    for neighbour in range(9):
        at = corner + neighbour // 3 * stride + neighbour % 3
        distance = dr.gather(plain.Float, sampled, at * _SAMPLED)
        nearest = dr.minimum(nearest, dr.select(distance < 0, np.inf, distance))
        farthest = dr.maximum(farthest, distance)
    specular = dr.gather(plain.Float, sampled, (corner + stride + 1) * _SAMPLED + 1)
    around = [nearest * (1 - SAME_SURFACE), farthest * (1 + SAME_SURFACE), dr.maximum(specular, 0)]
    table = dr.empty(plain.Float, _AROUND * height * width)
    values = plain.ArrayXf([*around, plain.Float(0)])
    dr.scatter(table, values, index, mode=dr.ReduceMode.Permute)
    dr.eval(table)
    return table


# Cosine of how far the direction of sight may turn until a surface shows something else: 8 degrees if it is
# glossy, 0.2 degrees if it is specular. What is diffuse looks the same from everywhere.
_GLOSSY_COSINE, _SPECULAR_COSINE = np.cos(np.radians([8.0, 0.2])).tolist()
# Distance along each axis up to which two viewpoints are the same.
_SAME_VIEWPOINT = 1e-6
# Of a view that shows what is seen now; with 1 more, from this very viewpoint.
_NOW = 2
# As a distance, infinity.
_FARTHEST = 0x7F800000


@dataclass(frozen=True)
class Reprojected:
    """Sums over reprojected samples, for the pixels of a rectangle of a frame.

    Attributes:
        arrays: the backend's array types.
        rows, columns: the rectangle.
        records: flat Float, h * w records (compose.fovea.samples), row by row.
    """

    arrays: Arrays
    rows: slice
    columns: slice
    records: Any

    def at(self, pixels: Any, width: int) -> list[Any]:
        """Sixteen Floats (D,), records of pixels (D,) of a frame of that width; 0 outside the rectangle."""
        arrays = self.arrays
        height, columns = (side.stop - side.start for side in (self.rows, self.columns))
        numbers = [self.rows.start, self.columns.start, height, columns]
        top, left, height, columns = arrays.scalars(arrays.plain.UInt, numbers)
        across = arrays.constant(width)
        row = pixels // across
        # What lies above or to the left wraps around to beyond the rectangle.
        down, right = row - top, pixels - row * across - left
        inside = (down < height) & (right < columns)
        shape = RECORD, dr.width(pixels)
        return list(
            dr.gather(arrays.plain.ArrayXf, self.records, down * columns + right, inside, shape=shape)
        )


def reproject(
    views: EarlierViews, camera: Camera, new: Samples, box: tuple[slice, slice]
) -> Reprojected | None:
    """What earlier views contribute to a camera's view, without what no longer holds.

    Positions and directions are computed in float64: a fifth of a degree decides about mirrors, and a sample
    at the border of a pixel must not end up on its other side. Distances and sums are float32.

    Args:
        views: the earlier views.
        camera: the view.
        new: samples of it, which show the surfaces that are visible now.
        box: rows and columns in which all of these lie.

    Returns:
        Sums over that rectangle; None if there are no samples on either side.
    """
    if not views.samples or not new.size:
        return None
    surfaces = VisibleSurfaces.of(views.arrays, camera, new, box)
    height, width = surfaces.shape
    records = _summed(views, _arrivals(views, camera, surfaces), height * width)
    return Reprojected(views.arrays, surfaces.rows, surfaces.columns, records)


@dataclass(frozen=True)
class _Arrivals:
    """Where M samples of earlier views lie in a rectangle of P pixels, as Dr.Jit arrays.

    Attributes:
        quarter: UInt (M,), quarter of a pixel: four times the pixel's index, plus 0 to 3; 4 P for a sample
            that lies elsewhere, or on a surface that is not visible or looks different now.
        distance: UInt (M,), bits of the distance from the camera as a Float, which rise with it.
        certain: Bool (M,), whether nothing can hide the sample.
        front: UInt (4 P + 1,), bits of the least distance in each quarter, those that lie elsewhere last.
    """

    quarter: Any
    distance: Any
    certain: Any
    front: Any


def _arrivals(views: EarlierViews, camera: Camera, surfaces: VisibleSurfaces) -> _Arrivals:
    """Samples of earlier views in the rectangle of the visible surfaces."""
    arrays, plain = views.arrays, views.arrays.plain
    height, width = surfaces.shape
    place = views.places(dr.arange(plain.UInt, views.samples))
    place = replace(place, position=views.moment.placed(arrays, place.position, place.mover))
    sight = _relative(arrays, place, [dr.opaque(plain.Float64, side) for side in camera.position.tolist()])
    across, down, inside = _quarters(arrays, sight, camera, surfaces)
    pixel = (down >> 1) * arrays.constant(width) + (across >> 1)
    distance = dr.sqrt(plain.Float(_product(sight, sight)))
    # Whatever was visible from this very position still is.
    certain, unchanged = _compared(views, place, sight, camera)
    holds = inside & (certain | (surfaces.contain(pixel, distance, place.gloss, inside) & unchanged))
    quarter = pixel << 2 | (down & 1) << 1 | across & 1
    quarter = dr.select(holds, quarter, arrays.constant(4 * height * width))
    bits = dr.reinterpret_array(plain.UInt, distance)
    # Reductions in kernels of their own take a third of the time.
    dr.eval(quarter, bits, certain)
    front = dr.full(plain.UInt, _FARTHEST, 4 * height * width + 1)
    dr.scatter_reduce(dr.ReduceOp.Min, front, bits, quarter)
    dr.eval(front)
    return _Arrivals(quarter, bits, certain, front)


def _summed(views: EarlierViews, arrivals: _Arrivals, pixels: int) -> Any:
    """Flat Float of the records of all pixels."""
    arrays, UInt, Float = views.arrays, views.arrays.plain.UInt, views.arrays.plain.Float
    pixel, count = _visible(arrays, arrivals, pixels)
    order = arrays.argsort(pixel, pixels + 1)
    target = dr.arange(UInt, pixels)
    start, count = (dr.gather(UInt, table, target) for table in (dr.prefix_sum(count), count))
    end = start + count

    def add(i: Any, sums: list[Any]) -> tuple[Any, list[Any]]:
        more = views.records(dr.gather(UInt, order, i))
        return i + 1, [one + other for one, other in zip(sums, more, strict=True)]

    # Built one by one: [Float(0)] * n would be a single accumulator n times.
    nothing = [Float(0) for _ in range(RECORD)]
    _, sums = dr.while_loop((start, nothing), lambda i, sums: i < end, add, mode="symbolic")
    # Evaluated before they are scattered: otherwise the scatter runs the loop again.
    dr.eval(sums)
    table = dr.empty(Float, RECORD * pixels)
    dr.scatter(table, arrays.plain.ArrayXf(sums), target, mode=dr.ReduceMode.Permute)
    dr.eval(table)
    return table


def _visible(arrays: Arrays, arrivals: _Arrivals, pixels: int) -> tuple[Any, Any]:
    """The pixel in which each sample is visible, or their number: UInt (M,); and samples in each of these."""
    UInt, Float = arrays.plain.UInt, arrays.plain.Float
    as_float = lambda bits: dr.reinterpret_array(Float, bits)  # noqa: E731
    # Whatever lies behind something nearer in the same quarter of a pixel is hidden by it.
    nearest = as_float(dr.gather(UInt, arrivals.front, arrivals.quarter))
    seen = arrivals.certain | (as_float(arrivals.distance) <= nearest * (1 + SAME_SURFACE))
    pixel = dr.select(seen, arrivals.quarter >> 2, arrays.constant(pixels))
    dr.eval(pixel)
    count = dr.zeros(UInt, pixels + 1)
    # Direct: pixels are many, so that threads rarely meet.
    dr.scatter_reduce(dr.ReduceOp.Add, count, UInt(1), pixel, mode=dr.ReduceMode.Direct)
    dr.eval(count)
    return pixel, count


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
        _product([number(entry) for entry in row], sight) for row in camera.world_to_camera[:3, :3]
    )
    inside = depth > 0
    inverse, found = 1 / depth, []
    for position, focal, middle, side in (
        (x, camera.fx, camera.cx, surfaces.columns),
        (y, camera.fy, camera.cy, surfaces.rows),
    ):
        quarter = 2 * (number(focal) * position * inverse + number(middle)) - number(2 * side.start)
        inside &= (quarter >= 0) & (quarter < number(2 * (side.stop - side.start)))
        found.append(quarter)
    # Numbers that an integer does not hold are not converted.
    across, down = (plain.UInt(dr.select(inside, quarter, 0)) for quarter in found)
    return across, down, inside


def _compared(views: EarlierViews, place: Places, sight: list[Any], camera: Camera) -> tuple[Any, Any]:
    """Whether samples come from this very viewpoint, and whether their surface looks the same from here.

    Args:
        views: the earlier views.
        place: of M samples, now.
        sight: three Float64 (M,), from the camera to the samples, in the world.
        camera: the view.
    """
    plain, viewpoints, now = views.arrays.plain, views.viewpoints(), views.of_now()
    same = (np.abs(viewpoints - camera.position) < _SAME_VIEWPOINT).all(axis=1) & now
    table = uploaded(plain.Float64, np.column_stack([viewpoints, same + _NOW * now]))
    *origin, kind = dr.gather(plain.ArrayXf64, table, place.view, shape=(4, dr.width(place.view)))
    before = _relative(views.arrays, place, origin)
    # Compared by their squares, which takes no root; both cosines are positive.
    product = _product(before, sight)
    least = dr.select(place.gloss == GLOSSY, plain.Float64(_GLOSSY_COSINE**2), _SPECULAR_COSINE**2)
    unturned = (product > 0) & (
        product * product >= least * _product(before, before) * _product(sight, sight)
    )
    is_diffuse = place.gloss == DIFFUSE
    lasting = (is_diffuse | unturned) & (kind >= _NOW) | is_diffuse & (place.mover != UNSTEADY)
    return kind > _NOW, lasting


def _product(one: list[Any], other: list[Any]) -> Any:
    """Scalar product of two vectors."""
    return sum(a * b for a, b in zip(one, other, strict=True))
