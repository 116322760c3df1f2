"""Samples of earlier views in device memory, and where a camera sees them now, on visible surfaces.

All views go through the same few kernels: each sample looks up the pixel in which it is visible, the samples
are sorted by pixel, and each pixel adds up its own, oldest first. So the same samples give the same sums, to
the bit, on any number of threads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from compose.base.traced_samples import ALWAYS, DIFFUSE, GLOSSY, SPECULAR, UNSTEADY
from compose.camera.camera import Camera
from compose.fovea.samples import RECORD, Samples
from compose.image.device_image import Box, shape_of

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, Float64, UInt

# Views that are remembered.
MOST_VIEWS = 16
# Floats that tell where a sample is, loaded as one packet.
_PLACE = 4
# The last float of a place holds mover, view and class of gloss: 20 of the 24 bits that it holds exactly.
_GLOSS_BITS, _VIEW_BITS = 2, (MOST_VIEWS - 1).bit_length()
# Moments after which samples are dropped, since light has changed: shadows of two moments ago are seen.
MOST_MOMENTS = 1
# Samples for which there is room at first: a disc of a small frame.
_LEAST_ROOM = 1 << 12
# Relative difference of distances up to which two hits are taken for the same surface.
SAME_SURFACE = 0.005
# Floats of a pixel that has been sampled, and of the surfaces around a pixel.
_SAMPLED, _AROUND = 2, 4
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
class EarlierView:
    """What was traced from one camera, for N of its pixels."""

    records: list[Float]  # sixteen (N,) (compose.fovea.samples), at least one sample each
    position: list[Float]  # three (N,), of what was hit, in the world; of what moves, where that is at rest
    gloss: Float  # (N,), of what was hit, as the mover
    mover: Float
    viewpoint: NDArray[np.float64]  # (3,) position of the camera
    time: float  # that it showed, from 0 to 1


class EarlierViews:
    """The samples of the last MOST_VIEWS views, one after another in a ring; they move only when it grows.

    `moment` is seen now, and set before views of it are added; `viewpoints` (MOST_VIEWS, 3) are positions of
    the cameras by number of their view, far away where there is none.
    """

    def __init__(self, arrays: Arrays):
        self.arrays, self.moment = arrays, ALWAYS
        self.clear()

    def clear(self) -> None:
        """Forgets all views."""
        self.viewpoints = np.full((MOST_VIEWS, 3), np.inf)
        # Times of views by number; numbers of samples of views, the oldest first.
        self._times = np.full(MOST_VIEWS, np.nan)
        self._sizes: deque[int] = deque()
        self._added = self._first = 0
        self._room = _LEAST_ROOM
        self._places, self._records = self._empty()

    @property
    def samples(self) -> int:
        """Number of samples of all views."""
        return sum(self._sizes)

    def of_now(self) -> NDArray[np.bool_]:
        """(MOST_VIEWS,) by number, whether a view shows the moment that is seen now."""
        return self._times == self.moment.time

    def add(self, view: EarlierView) -> None:
        """Adds a view; the oldest go where there are MOST_VIEWS, or MOST_MOMENTS other than now."""
        if len(self._sizes) == MOST_VIEWS:
            self._drop_oldest()
        now = self.moment.time
        while len({view.time, *self._times[~np.isnan(self._times)]} - {now}) > MOST_MOMENTS:
            self._drop_oldest()
        plain, constant = self.arrays.plain, self.arrays.constant
        number, size, before = self._added % MOST_VIEWS, dr.width(view.gloss), self.samples
        self.viewpoints[number], self._times[number] = view.viewpoint, view.time
        self._sizes.append(size)
        self._added += 1
        if before + size > self._room:
            self._grow(before, before + size)
        if size:
            tag = plain.UInt(view.gloss) | plain.UInt(view.mover) << (_GLOSS_BITS + _VIEW_BITS)
            tag |= constant(number << _GLOSS_BITS)
            slot = self._slot(dr.arange(plain.UInt, size) + constant(before))
            self._scatter([*view.position, plain.Float(tag)], view.records, slot)

    def _drop_oldest(self) -> None:
        number = (self._added - len(self._sizes)) % MOST_VIEWS
        self.viewpoints[number], self._times[number] = np.inf, np.nan
        self._first = (self._first + self._sizes.popleft()) % self._room

    def places(self, index: UInt) -> tuple[list[Float], UInt, UInt, UInt]:
        """Where the samples at an index (M,) are; the oldest view's first sample has index 0.

        Three Floats (M,), in the world, or at rest if it moves; UInts (M,): the class of gloss of what was
        hit, the number of the view, less than MOST_VIEWS, and the number of what was hit among what moves.
        """
        *position, tag = self.arrays.packet(self._places, _PLACE, self._slot(index))
        tag = self.arrays.plain.UInt(tag)
        gloss, view = tag & ((1 << _GLOSS_BITS) - 1), (tag >> _GLOSS_BITS) & (MOST_VIEWS - 1)
        return position, gloss, view, tag >> (_GLOSS_BITS + _VIEW_BITS)

    def records(self, index: UInt) -> list[Float]:
        """Sixteen Floats (M,): the records of the samples at an index."""
        return list(self.arrays.packet(self._records, RECORD, self._slot(index)))

    def _slot(self, index: UInt) -> UInt:
        """Where in the ring the samples at an index are."""
        # Its size is a power of two.
        return index + self.arrays.constant(self._first) & self.arrays.constant(self._room - 1)

    def _empty(self) -> tuple[Float, Float]:
        Float = self.arrays.plain.Float
        return dr.empty(Float, _PLACE * self._room), dr.empty(Float, RECORD * self._room)

    def _grow(self, samples: int, wanted: int) -> None:
        """Moves all samples to the start of a ring that has room for as many as wanted."""
        moved: list[Sequence[Float]] = []
        # Dr.Jit refuses to index with arrays of width 0.
        if samples:
            index = dr.arange(self.arrays.plain.UInt, samples)
            slot = self._slot(index)
            moved = [
                self.arrays.packet(*of, slot) for of in ((self._places, _PLACE), (self._records, RECORD))
            ]
        self._first, self._room = 0, 1 << (wanted - 1).bit_length()
        self._places, self._records = self._empty()
        if moved:
            self._scatter(moved[0], moved[1], index)

    def _scatter(self, places: Sequence[Float], records: Sequence[Float], slot: UInt) -> None:
        self.arrays.put_packet(self._places, places, slot)
        self.arrays.put_packet(self._records, records, slot)
        dr.eval(self._places, self._records)


@dataclass(frozen=True)
class VisibleSurfaces:
    """The surfaces that samples of a view hit, around each pixel of the rectangle in which these lie.

    The table has four floats of each pixel, row by row: the least and the greatest distance at which a
    surface may be that is visible in it or in the eight around it; 1 if the pixel itself shows something that
    mirrors or refracts, else 0; and 0.
    """

    arrays: Arrays
    box: Box
    table: Float

    @staticmethod
    def of(arrays: Arrays, camera: Camera, new: Samples, box: Box) -> VisibleSurfaces:
        """The surfaces that samples of a camera's view hit, at least one, all of which lie in a rectangle."""
        plain, (height, width) = arrays.plain, shape_of(box)
        # A frame of one pixel around the rectangle spares its edges a test.
        row, column = arrays.rows_columns(new.pixels, camera.width)
        top, left = (arrays.constant(side.start) for side in box)
        target = (row - top + 1) * arrays.constant(width + 2) + (column - left + 1)
        sight = _relative(arrays, new.position, _eye(arrays, camera))
        distance = plain.Float(dr.sqrt(_product(sight, sight)))
        specular = dr.select(new.gloss == SPECULAR, plain.Float(1), 0)
        # Distance of what a sample hits, or -1; and 1 if that is specular.
        sampled = dr.full(plain.Float, -1, _SAMPLED * (height + 2) * (width + 2))
        arrays.put_packet(sampled, [distance, specular], target)
        dr.eval(sampled)
        return VisibleSurfaces(arrays, box, _around(arrays, sampled, height, width))

    def contain(self, pixel: UInt, distance: Float, gloss: UInt, active: Bool) -> Bool:
        """Whether hits (M,) in pixels of the rectangle lie on these surfaces; not if they are not active."""
        around = self.arrays.packet(self.table, _AROUND, pixel, active)
        same = active & (distance >= around[0]) & (distance <= around[1])
        # Specular objects are thin in places, and what is visible beside them is far behind them.
        return same & ((around[2] == 0) | (gloss == SPECULAR))


def _around(arrays: Arrays, sampled: Float, height: int, width: int) -> Float:
    """The table of surfaces, from that of the pixels and of a frame around them."""
    plain, stride = arrays.plain, arrays.constant(width + 2)
    index = dr.arange(plain.UInt, height * width)
    row, column = arrays.rows_columns(index, width)
    corner = row * stride + column
    nearest, farthest = plain.Float(np.inf), plain.Float(0)
    for neighbour in range(9):
        at = corner + neighbour // 3 * stride + neighbour % 3
        distance = dr.gather(plain.Float, sampled, at * _SAMPLED)
        nearest = dr.minimum(nearest, dr.select(distance < 0, np.inf, distance))
        farthest = dr.maximum(farthest, distance)
    specular = dr.gather(plain.Float, sampled, (corner + stride + 1) * _SAMPLED + 1)
    around = [nearest * (1 - SAME_SURFACE), farthest * (1 + SAME_SURFACE), dr.maximum(specular, 0)]
    table = dr.empty(plain.Float, _AROUND * height * width)
    arrays.put_packet(table, [*around, plain.Float(0)], index)
    dr.eval(table)
    return table


@dataclass(frozen=True)
class Reprojected:
    """Sums over reprojected samples: h * w records (compose.fovea.samples), row by row, of a rectangle."""

    arrays: Arrays
    box: Box
    records: Float

    def at(self, pixels: UInt, width: int) -> list[Float]:
        """Sixteen Floats (D,), records of pixels (D,) of a frame of that width; 0 outside the rectangle."""
        arrays = self.arrays
        numbers = [*(side.start for side in self.box), *shape_of(self.box)]
        top, left, height, columns = arrays.scalars(arrays.plain.UInt, numbers)
        row, column = arrays.rows_columns(pixels, width)
        # What lies above or to the left wraps around to beyond the rectangle.
        down, right = row - top, column - left
        inside = (down < height) & (right < columns)
        return list(arrays.packet(self.records, RECORD, down * columns + right, inside))


def reproject(views: EarlierViews, camera: Camera, new: Samples, box: Box) -> Reprojected | None:
    """What earlier views contribute to a camera's view in a rectangle; None without samples on either side.

    New samples of the view, all in the rectangle, show the surfaces that are visible now.

    Positions and directions are computed in float64: a fifth of a degree decides about mirrors, and a sample
    at the border of a pixel must not end up on its other side. Distances and sums are float32.
    """
    if not views.samples or not new.size:
        return None
    surfaces = VisibleSurfaces.of(views.arrays, camera, new, box)
    height, width = shape_of(box)
    records = _summed(views, *_arrivals(views, camera, surfaces), height * width)
    return Reprojected(views.arrays, box, records)


def _arrivals(views: EarlierViews, camera: Camera, surfaces: VisibleSurfaces) -> tuple[UInt, UInt]:
    """The pixel (M,) of P in which each earlier sample is visible, and how many (P + 1,) are in each.

    P stands for samples that lie elsewhere, are hidden, or are on a surface that is not visible or looks
    different now.
    """
    arrays, plain = views.arrays, views.arrays.plain
    height, width = shape_of(surfaces.box)
    rest, gloss, view, mover = views.places(dr.arange(plain.UInt, views.samples))
    position = views.moment.placed(arrays, rest, mover)
    sight = _relative(arrays, position, _eye(arrays, camera))
    across, down, inside = _quarters(arrays, sight, camera, surfaces.box)
    pixel = (down >> 1) * arrays.constant(width) + (across >> 1)
    distance = dr.sqrt(plain.Float(_product(sight, sight)))
    # Whatever was visible from this very position still is.
    certain, unchanged = _compared(views, (gloss, view, mover), position, sight, camera)
    holds = inside & (certain | (surfaces.contain(pixel, distance, gloss, inside) & unchanged))
    # Quarters of pixels: four times the pixel's index, plus 0 to 3; 4 P for those that are nowhere.
    quarter = pixel << 2 | (down & 1) << 1 | across & 1
    quarter = dr.select(holds, quarter, arrays.constant(4 * height * width))
    # Bits of distances rise with these.
    bits = dr.reinterpret_array(plain.UInt, distance)
    # Reductions in kernels of their own take a third of the time.
    dr.eval(quarter, bits, certain)
    front = dr.full(plain.UInt, _FARTHEST, 4 * height * width + 1)
    dr.scatter_reduce(dr.ReduceOp.Min, front, bits, quarter)
    dr.eval(front)
    as_float = lambda bits: plain.Float(dr.reinterpret_array(plain.Float, bits))  # noqa: E731
    # Whatever lies behind something nearer in the same quarter of a pixel is hidden by it.
    nearest = as_float(dr.gather(plain.UInt, front, quarter))
    seen = certain | (as_float(bits) <= nearest * (1 + SAME_SURFACE))
    pixel = dr.select(seen, quarter >> 2, arrays.constant(height * width))
    dr.eval(pixel)
    count = dr.zeros(plain.UInt, height * width + 1)
    # Direct: pixels are many, so that threads rarely meet.
    dr.scatter_reduce(dr.ReduceOp.Add, count, plain.UInt(1), pixel, mode=dr.ReduceMode.Direct)
    dr.eval(count)
    return pixel, count


def _summed(views: EarlierViews, pixel: UInt, count: UInt, pixels: int) -> Float:
    """Flat Float of the records of all pixels, from what `_arrivals` found."""
    arrays, plain = views.arrays, views.arrays.plain
    order = arrays.argsort(pixel, pixels + 1)
    target = dr.arange(plain.UInt, pixels)
    start, count = (dr.gather(plain.UInt, table, target) for table in (dr.prefix_sum(count), count))
    end = start + count

    def add(i: UInt, sums: list[Float]) -> tuple[UInt, list[Float]]:
        more = views.records(dr.gather(plain.UInt, order, i))
        return i + 1, [one + other for one, other in zip(sums, more, strict=True)]

    def remains(i: UInt, sums: list[Float]) -> Bool:
        return i < end

    # Built one by one: [plain.Float(0)] * n would be a single accumulator n times.
    nothing = [plain.Float(0) for _ in range(RECORD)]
    _, sums = dr.while_loop((start, nothing), remains, add, mode="symbolic")
    # Evaluated before they are scattered: otherwise the scatter runs the loop again.
    dr.eval(sums)
    table = dr.empty(plain.Float, RECORD * pixels)
    arrays.put_packet(table, sums, target)
    dr.eval(table)
    return table


def _eye(arrays: Arrays, camera: Camera) -> list[Float64]:
    """Three Float64 of width 1, the camera's position."""
    return [dr.opaque(arrays.plain.Float64, side) for side in camera.position.tolist()]


def _relative(arrays: Arrays, position: list[Float] | list[Float64], origin: list[Float64]) -> list[Float64]:
    """Vectors to positions from origins, of width 1 or (M,)."""
    return [arrays.plain.Float64(at) - start for at, start in zip(position, origin, strict=True)]


def _quarters(arrays: Arrays, sight: list[Float64], camera: Camera, box: Box) -> tuple[UInt, UInt, Bool]:
    """Column and row among the quarters of a rectangle's pixels, and whether it holds the sample."""
    plain = arrays.plain
    number = lambda value: dr.opaque(plain.Float64, float(value))  # noqa: E731
    x, y, depth = (
        _product([number(entry) for entry in row], sight) for row in camera.world_to_camera[:3, :3]
    )
    inside = depth > 0
    inverse, found = 1 / depth, []
    axes = (y, camera.fy, camera.cy), (x, camera.fx, camera.cx)
    for (position, focal, middle), side in zip(axes, box, strict=True):
        quarter = 2 * (number(focal) * position * inverse + number(middle)) - number(2 * side.start)
        inside &= (quarter >= 0) & (quarter < number(2 * (side.stop - side.start)))
        found.append(quarter)
    # Numbers that an integer does not hold are not converted.
    down, across = (plain.UInt(dr.select(inside, quarter, 0)) for quarter in found)
    return across, down, inside


def _compared(
    views: EarlierViews,
    tags: tuple[UInt, UInt, UInt],
    position: list[Float] | list[Float64],
    sight: list[Float64],
    camera: Camera,
) -> tuple[Bool, Bool]:
    """Whether samples come from this very viewpoint, and whether their surface looks the same from here.

    Tags are gloss, view and mover; positions and lines of sight are those of now.
    """
    gloss, view, mover = tags
    plain, now = views.arrays.plain, views.of_now()
    same = (np.abs(views.viewpoints - camera.position) < _SAME_VIEWPOINT).all(axis=1) & now
    table = uploaded(plain.Float64, np.column_stack([views.viewpoints, same + _NOW * now]))
    *origin, kind = views.arrays.packet(table, 4, view)
    before = _relative(views.arrays, position, origin)
    # Compared by their squares, which takes no root; both cosines are positive.
    product = _product(before, sight)
    least = dr.select(gloss == GLOSSY, plain.Float64(_GLOSSY_COSINE**2), _SPECULAR_COSINE**2)
    unturned = (product > 0) & (
        product * product >= least * _product(before, before) * _product(sight, sight)
    )
    is_diffuse = gloss == DIFFUSE
    lasting = (is_diffuse | unturned) & (kind >= _NOW) | is_diffuse & (mover != UNSTEADY)
    return kind > _NOW, lasting


def _product(one: list[Float64], other: list[Float64]) -> Float64:
    return dr.sum([a * b for a, b in zip(one, other, strict=True)])
