"""Cells of surface: places of about one size and orientation, their names, and the hash table of these."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float32]
Indices: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]

# Sides of the cells of each level, in units of the cells' scale.
SIDES = (0.02, 0.08, 0.4)
# Points that a cell of each level must have; a large cell needs more, for its light varies.
_FEWEST = (8, 8, 16)
# Normals have six main directions, so that the sides of a thin wall or of a corner are told apart.
_ORIENTATIONS = 8
# Of the two names of a cell: large odd numbers.
_FACTORS = (
    (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D, 0x27D4EB2F),
    (0x165667B1, 0xD6E8FEB9, 0xA5CB9243, 0x7FEB352D),
)
# Of a hash table: places searched for a cell, from that of its first name on, and places per cell at least.
_PROBES, _ROOM = 4, 3


@dataclass(frozen=True)
class Points:
    """N points on surfaces: positions (N, 3) in the world, and unit normals (N, 3) of the lit side."""

    position: Floats
    normal: Floats

    @staticmethod
    def none() -> Points:
        """No points."""
        nothing = np.zeros((0, 3), dtype=np.float32)
        return Points(nothing, nothing)

    def __len__(self) -> int:
        return len(self.position)

    @property
    def arrays(self) -> tuple[mi.Point3f, mi.Normal3f]:
        """Positions and normals as Dr.Jit arrays."""
        return mi.Point3f(self.position.T), mi.Normal3f(self.normal.T)

    def take(self, chosen: NDArray[Any]) -> Points:
        """Some of the points, by index or mask."""
        return Points(self.position[chosen], self.normal[chosen])


def joined_points(parts: Sequence[Points]) -> Points:
    """The points of all parts, one part after the other."""
    position, normal = (np.concatenate([getattr(p, n) for p in parts]) for n in ("position", "normal"))
    return Points(position, normal)


@dataclass(frozen=True, eq=False)
class Grid:
    """Where cells lie: an origin (3,) in the world, and a typical distance there, the unit of their sides."""

    origin: Floats
    scale: float

    def keys(self, points: Points, level: int) -> NDArray[np.uint64]:
        """(N,) both names of the cells that points lie in, as one number."""
        if not len(points):
            return np.zeros(0, dtype=np.uint64)
        first, second = cell_names(*self.local(points), level)
        dr.eval(first, second)
        keys: NDArray[np.uint64] = first.numpy().astype(np.uint64) << np.uint64(32) | second.numpy()
        return keys

    def local(self, points: Points) -> tuple[mi.Point3f, mi.Normal3f]:
        """Points as `cell_names` takes them."""
        (origin, scale), (position, normal) = self.arrays, points.arrays
        return (position - origin) / scale, normal

    @cached_property
    def arrays(self) -> tuple[Any, Any]:
        """Origin and scale as Dr.Jit values that are not part of a kernel."""
        arrays = mi.Point3f(*self.origin.tolist()), mi.Float(self.scale)
        dr.make_opaque(arrays)
        return arrays


# Whether nothing lies between points, given by their indices (M,) each, and the side of their cell.
Joined = Callable[[Indices, Indices, float], Mask]


@dataclass(frozen=True, eq=False)
class Cells:
    """C cells of a grid, one level after the other."""

    grid: Grid
    keys: tuple[NDArray[np.uint64], ...]  # (C_l,) names of the cells of each level, sorted
    counts: tuple[Indices, ...]  # (C_l,) numbers of points in them

    @staticmethod
    def of(points: Points, grid: Grid, joined: Joined) -> Cells:
        """The cells of points on surfaces, but for those that something, such as a thin wall, divides."""
        keys, counts = [], []
        for level, side in enumerate(SIDES):
            key = grid.keys(points, level)
            unique, one, cell, count = np.unique(
                key, return_index=True, return_inverse=True, return_counts=True
            )
            whole = np.ones(len(unique), dtype=bool)
            whole[cell[~joined(np.arange(len(key)), one[cell], side * grid.scale)]] = False
            keys.append(unique[whole])
            counts.append(count[whole])
        return Cells(grid, tuple(keys), tuple(counts))

    @cached_property
    def known(self) -> Mask:
        """(C,) whether enough points lie in each cell to show its mean."""
        return np.concatenate([n >= fewest for n, fewest in zip(self.counts, _FEWEST, strict=True)])

    def smallest(self, points: Points) -> Indices:
        """(N,) index of the smallest cell that each point lies in, whether enough is known of it or not.

        Larger cells reach past edges behind which it may be much brighter.
        """
        smallest = np.full(len(points), -1)
        for cell in reversed(self.indices(points)):
            smallest = np.where(cell >= 0, cell, smallest)
        return smallest

    def only_known(self) -> Cells:
        """The cells that are known."""
        ends = np.cumsum([len(keys) for keys in self.keys])[:-1]
        parts = zip(self.keys, self.counts, np.split(self.known, ends), strict=True)
        keys, counts = zip(*((keys[kept], counts[kept]) for keys, counts, kept in parts), strict=True)
        return Cells(self.grid, keys, counts)

    def __len__(self) -> int:
        return sum(len(keys) for keys in self.keys)

    def indices(self, points: Points) -> Indices:
        """(levels, N) index of the cell of each level that each point lies in; -1 where none is known."""
        if not len(points):
            return np.zeros((len(SIDES), 0), dtype=np.int64)
        local, found = self.grid.local(points), []
        for level in range(len(SIDES)):
            known, cell = find(self.table.arrays, *cell_names(*local, level), mi.Bool(True))
            found.append(dr.select(known, mi.Int32(cell), -1))
        dr.eval(found)
        return np.stack([one.numpy() for one in found]).astype(np.int64)

    @cached_property
    def table(self) -> Table:
        """Finds the cells of all levels."""
        return Table(np.concatenate(self.keys))


def cell_names(position: mi.Point3f, normal: mi.Normal3f, level: int) -> tuple[Any, Any]:
    """Two names of the cells of a level that N points lie in, in units of the scale, from the origin."""
    x, y, z = (mi.UInt32(mi.Int32(values)) for values in dr.floor(position / SIDES[level]))
    size = dr.abs(normal)
    # Ties go to the first axis.
    last = dr.select(size.y >= size.z, mi.UInt32(1), mi.UInt32(2))
    axis = dr.select((size.x >= size.y) & (size.x >= size.z), mi.UInt32(0), last)
    along = dr.select(axis == 0, normal.x, dr.select(axis == 1, normal.y, normal.z))
    kind = 2 * axis + dr.select(along > 0, mi.UInt32(1), mi.UInt32(0)) + _ORIENTATIONS * level
    first, second = (_mixed((x, y, z, kind), factors) for factors in _FACTORS)
    # 0 marks an empty place in a table.
    return first, second | 1


def _mixed(parts: Sequence[Any], factors: tuple[int, ...]) -> mi.UInt32:
    """32 bits in which neighbouring cells have nothing in common, by the finalizer of MurmurHash3 (Appleby).

    A sum of products gives cells near each other different numbers, which an exclusive or would not.
    """
    bits = sum(part * mi.UInt32(factor) for part, factor in zip(parts, factors, strict=True))
    bits = (bits ^ (bits >> 16)) * mi.UInt32(0x85EBCA6B)
    bits = (bits ^ (bits >> 13)) * mi.UInt32(0xC2B2AE35)
    return bits ^ (bits >> 16)


class Table:
    """Finds cells, given by their keys (C,), by their names: an open hash table of a power of two places.

    Each place has the second name and the index of a cell; a name of 0 stands for none.
    """

    def __init__(self, keys: NDArray[np.uint64]):
        # Of the two names in each, one chooses places in the table, and the other recognizes cells there.
        first, second = (keys >> np.uint64(32)).astype(np.uint32), keys.astype(np.uint32)
        size = 1 << max(4, int(np.ceil(np.log2(_ROOM * len(keys) + 1))))
        while not self._holds(size, first, second):
            size *= 2

    @cached_property
    def arrays(self) -> tuple[Any, Any]:
        """The table as Dr.Jit arrays for `find`."""
        return mi.UInt32(self.names), mi.UInt32(self.indices)

    def _holds(self, size: int, first: NDArray[np.uint32], second: NDArray[np.uint32]) -> bool:
        """Puts the cells into a new table of that size; False if it is too full."""
        self.names, self.indices = np.zeros(size, np.uint32), np.zeros(size, np.uint32)
        waiting = np.arange(len(first))
        for probe in range(_PROBES):
            here = (first[waiting].astype(np.int64) + probe) & (size - 1)
            # Of the cells that want the same place, the first gets it.
            _, winner = np.unique(here, return_index=True)
            winner = winner[self.names[here[winner]] == 0]
            self.names[here[winner]] = second[waiting[winner]]
            self.indices[here[winner]] = waiting[winner]
            waiting = np.delete(waiting, winner)
        return not len(waiting)


def find(table: tuple[Any, Any], first: mi.UInt32, second: mi.UInt32, active: mi.Bool) -> tuple[Any, Any]:
    """Whether a `Table` has N cells, given by their names, and their indices (0 where it has not)."""
    names, indices = table
    last = dr.width(names) - 1
    known, place = mi.Bool(False), mi.UInt32(0)
    for probe in range(_PROBES):
        here = (first + probe) & last
        asks = active & ~known
        found = asks & (dr.gather(mi.UInt32, names, here, asks) == second)
        place = dr.select(found, here, place)
        known |= found
    return known, dr.gather(mi.UInt32, indices, place, known)
