"""Which splats touch which tiles, from near to far."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from splat.raster.projection import NEAR, Splats
from splat.raster.records import RecordLayout
from splat.raster.tiles import TileGrid

# Depths are sorted by so many bits: 32 octaves from the near plane in steps of one part in 131,072. Where
# something lies further away, the steps are up to eight times as large.
_DEPTH_BITS = 22
_DEPTH_SHIFT = 6
# Below this a contribution is invisible on an 8-bit display; every extent follows from it.
MINIMUM_ALPHA = 1 / 255
# A splat's ellipse and its box of tiles: its first column plus 2^16 times its first row, and its number of
# columns. Nothing is spare.
_ELLIPSE = "x", "y", "x_precision", "shear", "y_precision", "opacity"
_BOX = RecordLayout((8,), ("corner", "across"), **dict.fromkeys(_ELLIPSE, 1), corner=1, across=1)


@dataclass(frozen=True)
class Bins:
    """For each tile the list of splats that it blends.

    Before they are sorted, the pairs of a splat lie side by side, in a run; the gradient sums over runs.
    """

    arrays: Arrays
    grid: TileGrid  # the tiles
    wanted: NDArray[np.bool_]  # (rows, columns) bool, the tiles that are rasterized
    # (2 * columns * rows + 2,) start and end of each tile's list; the last one is that of the pairs that no
    # tile blends.
    ranges: Any
    splat: Any  # (P,) splat of each pair, sorted by tile, then by depth
    tile: Any  # (P,) tile of each pair, columns * rows for those that no tile blends
    unsorted: Any  # (P,) position of each pair before sorting
    first: Any  # first, count: (S,) the run of each of S splats, which may be empty
    count: Any
    owner: Any  # (S,) these splats

    @cached_property
    def tiles(self) -> Any:
        """(T,) numbers of the tiles that are rasterized, row by row."""
        return uploaded(self.arrays.plain.UInt, np.flatnonzero(self.wanted).astype(np.uint32))

    def list_of(self, tile: Any) -> tuple[Any, Any]:
        """(M,) start and end of the lists of tiles."""
        return tuple(dr.gather(self.arrays.plain.ArrayXu, self.ranges, tile, shape=(2, dr.width(tile))))

    @property
    def pairs(self) -> int:
        """P, not counting pairs that no tile blends; waits for the lists."""
        return int(self.ranges[2 * self.grid.columns * self.grid.rows])


@dataclass(frozen=True)
class TileBounds:
    """Tiles that each of N splats is confined to, for a frame that holds several images above each other."""

    columns: Any  # (N,) width in tiles; all begin at the left edge
    top: Any  # top, bottom: (N,) first row of tiles, and the row after the last
    bottom: Any


class TileWindow(NamedTuple):
    """A rectangle of tiles; right and bottom are exclusive."""

    left: int
    top: int
    right: int
    bottom: int


class Candidates:
    """Tiles that each splat may touch, from which the lists of any part of the frame are made.

    Args:
        splats: without derivatives.
        wanted: (rows, columns) bool, the tiles to rasterize; all by default.
        bounds: tiles that each splat is confined to; all by default.
        in_order: whether splats that meet in a tile come from near to far already.
    """

    def __init__(
        self,
        arrays: Arrays,
        splats: Splats,
        grid: TileGrid,
        wanted: NDArray[np.bool_] | None = None,
        bounds: TileBounds | None = None,
        in_order: bool = False,
    ):
        self._arrays, self._splats, self.grid = arrays, splats, grid
        self.whole = TileWindow(0, 0, grid.columns, grid.rows)
        self.wanted, self._all_wanted = grid.mask(wanted), wanted is None
        everywhere = TileBounds(arrays.constant(grid.columns), 0, arrays.constant(grid.rows))
        self._boxes = _boxes(arrays, splats, bounds or everywhere, grid.side)
        # Later, and together with what else is made of the splats: this makes one kernel of all.
        dr.schedule(self._boxes.__dict__)
        seen = self._boxes.across > 0
        self._order = None if in_order else depth_order(arrays, splats.depth, seen)

    def runs(self, window: TileWindow) -> Runs:
        """The candidates in a window, counted but not listed."""
        tiles = np.zeros_like(self.wanted)
        inside = slice(window.top, window.bottom), slice(window.left, window.right)
        tiles[inside] = self.wanted[inside]
        if not tiles.any():
            return Runs(tiles, 0)
        boxes = self._boxes if window == self.whole else _clipped(self._arrays, self._boxes, window)
        return _runs(self._arrays, self._splats, boxes, self._order, tiles)

    def bins(self, runs: Runs) -> Bins:
        """The lists of a window's tiles from its runs."""
        if not runs.pairs:
            UInt, ranges = self._arrays.plain.UInt, 2 * self.grid.columns * self.grid.rows + 2
            none = [dr.zeros(UInt, 0) for _ in range(6)]
            return Bins(self._arrays, self.grid, runs.wanted, dr.zeros(UInt, ranges), *none)
        mask = None if self._all_wanted else self.wanted
        key, splat = _pairs(self._arrays, runs, self.grid, mask)
        return _sorted(self._arrays, self.grid, runs, key, splat)


def depth_order(arrays: Arrays, depth: Any, seen: Any) -> Any:
    """Indices of splats from near to far, those that are not seen last.

    Depths that agree to one part in 100,000 count as equal, in scenes that reach beyond 32 octaves from the
    near plane to one in 16,000; their splats keep the order of their indices.
    """
    bits = lambda value: dr.reinterpret_array(arrays.plain.UInt, value)  # noqa: E731
    # The bits of positive floats rise with their values; the upper ones are enough.
    steps = dr.select(seen, bits(dr.maximum(depth, NEAR)) - bits(arrays.plain.Float(NEAR)), 0)
    last = (1 << _DEPTH_BITS) - 1
    shift, farthest = arrays.plain.UInt(_DEPTH_SHIFT), dr.max(steps)
    for further in range(3):
        shift += dr.select(farthest >> (_DEPTH_SHIFT + further) >= last, arrays.plain.UInt(1), 0)
    # Not a number is beyond all.
    return arrays.argsort(dr.select(seen, dr.minimum(steps >> shift, last - 1), last), last + 1)


@dataclass(frozen=True)
class _Boxes:
    """Tiles that the boxes around N splats touch, UInts of width N."""

    left: Any  # left, top: first column and row
    top: Any
    across: Any  # across, down: numbers of columns and rows, 0 for a splat that is not seen
    down: Any


def _boxes(arrays: Arrays, splats: Splats, bounds: TileBounds, side: int) -> _Boxes:
    """Tiles that the box around each splat's visible ellipse touches."""
    Int, UInt = arrays.plain.Int, arrays.plain.UInt
    # exp(-q / 2) opacity = 1/255 is the ellipse q = 2 ln(255 opacity); the covariance's diagonal bounds it.
    level = 2 * dr.log(dr.maximum(splats.opacity * (1 / MINIMUM_ALPHA), 1))
    yy = dr.rcp(splats.y_precision)
    reach_x = dr.sqrt(level * dr.fma(dr.square(splats.shear), yy, dr.rcp(splats.x_precision)))
    reach_y = dr.sqrt(level * yy)
    seen = splats.opacity > MINIMUM_ALPHA
    in_tiles = lambda value, low, high: dr.clip(value * (1 / side), low, high)  # noqa: E731
    x0 = Int(dr.floor(in_tiles(splats.x - reach_x, 0, bounds.columns)))
    y0 = Int(dr.floor(in_tiles(splats.y - reach_y, bounds.top, bounds.bottom)))
    x1 = Int(dr.ceil(in_tiles(splats.x + reach_x, 0, bounds.columns)))
    y1 = Int(dr.ceil(in_tiles(splats.y + reach_y, bounds.top, bounds.bottom)))
    # One number that is none, or infinite, and the splat touches no tile: not even a weight of 0 would keep
    # it from a pixel there.
    numbers = reach_x + reach_y + splats.x + splats.y + splats.red + splats.green + splats.blue
    seen &= (x1 > x0) & (y1 > y0) & dr.isfinite(numbers)
    across, down = dr.select(seen, UInt(x1 - x0), 0), dr.select(seen, UInt(y1 - y0), 0)
    return _Boxes(UInt(x0), UInt(y0), across, down)


def _clipped(arrays: Arrays, boxes: _Boxes, window: TileWindow) -> _Boxes:
    """The parts of boxes inside a window."""
    left, top, right, bottom = (arrays.constant(side) for side in window)
    first_x, first_y = dr.maximum(boxes.left, left), dr.maximum(boxes.top, top)
    end_x, end_y = dr.minimum(boxes.left + boxes.across, right), dr.minimum(boxes.top + boxes.down, bottom)
    inside = (boxes.across > 0) & (end_x > first_x) & (end_y > first_y)
    across, down = dr.select(inside, end_x - first_x, 0), dr.select(inside, end_y - first_y, 0)
    return _Boxes(first_x, first_y, across, down)


@dataclass(frozen=True)
class Runs:
    """Candidate pairs of splat and tile in a window: a run per splat, one tile after another."""

    wanted: NDArray[np.bool_]  # (rows, columns) bool, the window's tiles that are rasterized
    pairs: int  # number of candidates; if that is 0, nothing else is set
    order: Any = None  # (S,) splats; None for all of them as they are
    first: Any = None  # first, count: (S,) the run of each of them; some are empty
    count: Any = None
    boxes: Any = None  # records of all splats' ellipses and boxes


def _runs(arrays: Arrays, splats: Splats, boxes: _Boxes, order: Any, wanted: NDArray[np.bool_]) -> Runs:
    """Counts the candidates of each splat."""
    UInt = arrays.plain.UInt
    ellipse = {name: getattr(splats, name) for name in _ELLIPSE}
    records = _BOX.pack(arrays, **ellipse, corner=boxes.left | boxes.top << 16, across=boxes.across)
    count = boxes.across * boxes.down
    # Many splats on a large frame are more pairs than 32 bits count. Where it matters, `first` has wrapped,
    # and whoever asked splits the window.
    wide = arrays.plain.UInt64(count if order is None else dr.gather(UInt, count, order))
    end = dr.cumsum(wide)
    return Runs(wanted, int(end[dr.width(end) - 1]), order, UInt(end - wide), UInt(wide), records)


def _pairs(arrays: Arrays, runs: Runs, grid: TileGrid, wanted: NDArray[np.bool_] | None) -> tuple[Any, Any]:
    """For each candidate the key that it is sorted by, and its splat.

    The key is the number of the tile, or columns * rows for a candidate that need not be drawn.
    """
    UInt = arrays.plain.UInt
    # Mark the first pair of each run by the run's number: the largest so far tells whose run a pair lies in.
    marks = dr.zeros(UInt, runs.pairs)
    dr.scatter(marks, dr.arange(UInt, dr.width(runs.first)), runs.first, runs.count > 0)
    dr.eval(runs.first, marks)
    run = dr.prefix_reduce(dr.ReduceOp.Max, marks, exclusive=False)
    splat = run if runs.order is None else dr.gather(UInt, runs.order, run)
    box = runs.boxes.at(splat)
    within = dr.arange(UInt, runs.pairs) - dr.gather(UInt, runs.first, run)
    # Masked lanes divide as well, and a division by zero raises SIGFPE on the CPU.
    across = dr.maximum(box.across, 1)
    row = within // across
    tile_x = (box.corner & 0xFFFF) + within - row * across
    tile_y = (box.corner >> 16) + row
    tile = tile_y * arrays.constant(grid.columns) + tile_x
    keep = _reaches(arrays, box, tile_x, tile_y, grid.side)
    if wanted is not None:
        keep &= dr.gather(arrays.plain.Bool, uploaded(arrays.plain.Bool, wanted), tile)
    key = dr.select(keep, tile, arrays.constant(grid.columns * grid.rows))
    dr.eval(key, splat)
    return key, splat


def _reaches(arrays: Arrays, splat: SimpleNamespace, tile_x: Any, tile_y: Any, side: int) -> Any:
    """Whether a splat is visible anywhere between the outermost pixel centres of a tile.

    The box of a long diagonal splat holds many tiles that its ellipse misses. The largest value of the
    Gaussian over a rectangle lies at its centre or on one of the two edges next to the centre.
    """
    Float = arrays.plain.Float
    left, top = Float(tile_x * side) + 0.5 - splat.x, Float(tile_y * side) + 0.5 - splat.y
    right, bottom = left + (side - 1), top + (side - 1)
    near_x, near_y = dr.clip(0, left, right), dr.clip(0, top, bottom)
    # Where the Gaussian is largest on a column, and on a row.
    # The least denominator keeps a round splat of extreme proportions, 0 / 0, from becoming NaN.
    ratio = splat.y_precision / splat.x_precision
    slope = -splat.shear / dr.maximum(dr.fma(splat.shear, splat.shear, ratio), 1e-37)
    along_y = dr.clip(slope * near_x, top, bottom)
    along_x = dr.clip(-splat.shear * near_y, left, right)

    def quadratic(u: Any, v: Any) -> Any:
        t = dr.fma(splat.shear, v, u)
        return splat.x_precision * t * t + splat.y_precision * v * v

    nearest = dr.minimum(quadratic(near_x, along_y), quadratic(along_x, near_y))
    # Slack for rounding: what is kept in excess here, the rasterizer tests pixel by pixel.
    return nearest <= 2 * dr.log(splat.opacity * (1 / MINIMUM_ALPHA)) + 1e-3


def _sorted(arrays: Arrays, grid: TileGrid, runs: Runs, key: Any, splat: Any) -> Bins:
    """The candidates sorted by tile; candidates of one tile keep their order."""
    UInt, count = arrays.plain.UInt, grid.columns * grid.rows
    sorting = arrays.argsort(key, count + 1)
    # What no pair says: lists, also empty ones, end behind the last pair, and so do those to be blended.
    ranges = dr.full(UInt, runs.pairs, 2 * (count + 1))
    lane = dr.arange(UInt, runs.pairs)
    own = dr.gather(UInt, key, sorting)
    before = dr.gather(UInt, key, dr.gather(UInt, sorting, lane - 1, lane > 0), lane > 0)
    dr.scatter(ranges, lane, own * 2, (lane == 0) | (own != before))
    dr.scatter(ranges, lane, before * 2 + 1, (lane > 0) & (own != before))
    # Not evaluated yet: one kernel finds the ranges and gathers what the tiles read.
    owner = dr.arange(UInt, dr.width(runs.first)) if runs.order is None else runs.order
    sorted_splat = dr.gather(UInt, splat, sorting)
    pairs, found = (sorted_splat, own, sorting), (runs.first, runs.count, owner)
    return Bins(arrays, grid, runs.wanted, ranges, *pairs, *found)
