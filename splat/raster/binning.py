"""Which splats touch which tiles, from near to far."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import TYPE_CHECKING, NamedTuple

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays, uploaded
from compose.base.frozen import Frozen, capacity
from splat.model.points import Bits
from splat.raster.projection import NEAR, Splats
from splat.raster.records import RecordLayout, Records
from splat.raster.tiles import GridNumbers, TileGrid

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt, UInt64

# Depths are sorted by so many bits: 32 octaves from the near plane in steps of one part in 131,072. Where
# something lies further away, the steps are up to eight times as large.
_DEPTH_BITS = 22
_DEPTH_SHIFT = 6
# Below this a contribution is invisible on an 8-bit display; every extent follows from it.
MINIMUM_ALPHA = 1 / 255
# A splat as the tiles read it: centre, log2 of its alpha at (dx, dy) from there as constant - u^2 - v^2 with
# u = u_x dx + u_y dy and v = v_y dy, and radiance. One float is spare.
_BLENDED = RecordLayout((8, 2), x=1, y=1, u_x=1, u_y=1, v_y=1, constant=1, red=1, green=1, blue=1)
LOG2_E = 1.4426950408889634
# A splat's ellipse and its box of tiles: first column plus 2^16 times the first row, and number of columns.
_ELLIPSE = "x", "y", "x_precision", "shear", "y_precision", "opacity"
_BOX = RecordLayout((8,), ("corner", "across"), **dict.fromkeys(_ELLIPSE, 1), corner=1, across=1)


@dataclass(frozen=True)
class Lists:
    """For each tile the list of splats that it blends; P pairs of tile and splat.

    Pairs that no tile blends come last, as the list of a tile of their own.
    """

    grid: GridNumbers
    pairs: int  # P
    ranges: UInt  # (2 * tiles + 2,) start and end of each tile's list
    splat: UInt  # (P,) splat of each pair, sorted by tile, then by depth
    tile: UInt  # (P,) tile of each pair, or the number of tiles
    unsorted: UInt  # (P,) position of each pair before sorting

    def of(self, arrays: Arrays, tile: UInt) -> tuple[UInt, UInt]:
        """(M,) start and end of the lists of tiles."""
        start, end = dr.gather(arrays.plain.ArrayXu, self.ranges, tile, shape=(2, dr.width(tile)))
        return start, end


@dataclass(frozen=True)
class Bins:
    """The lists of a frame's tiles, and the runs of pairs, each of one splat, that they were sorted from."""

    arrays: Arrays
    grid: TileGrid
    wanted: Bits  # (rows, columns) the tiles that are rasterized
    lists: Lists
    first: UInt  # first, count: (S,) the run of each of S splats, which may be empty
    count: UInt
    owner: UInt  # (S,) these splats

    @cached_property
    def tiles(self) -> UInt:
        """(T,) numbers of the tiles that are rasterized, row by row."""
        return uploaded(self.arrays.plain.UInt, np.flatnonzero(self.wanted).astype(np.uint32))

    @property
    def pairs(self) -> int:
        """Number of pairs that tiles blend; waits for the lists."""
        return int(self.lists.ranges[2 * self.grid.columns * self.grid.rows])


@dataclass(frozen=True)
class TileBounds:
    """Tiles that each of N splats is confined to, for a frame that holds several images above each other."""

    columns: UInt  # (N,) width in tiles; all begin at the left edge
    top: UInt  # top, bottom: (N,) first row of tiles, and the row after the last
    bottom: UInt


def everywhere(arrays: Arrays, grid: TileGrid) -> TileBounds:
    """All tiles of a grid."""
    return TileBounds(*map(arrays.constant, (grid.columns, 0, grid.rows)))


class TileWindow(NamedTuple):
    """A rectangle of tiles; right and bottom are exclusive."""

    left: int
    top: int
    right: int
    bottom: int


@dataclass(frozen=True)
class Boxed:
    """N splats as lists of them are made and blended."""

    blended: Records  # what tiles read of them
    boxes: Records  # their ellipses, and the boxes of tiles around these
    count: UInt  # (N,) tiles in each box, 0 for a splat that is not seen


class Candidates:
    """Tiles that each splat may touch, from which the lists of any part of the frame are made.

    Args:
        found: the splats, as boxed for the grid's tiles.
        wanted: (rows, columns) the tiles to rasterize; all by default.
        order: (N,) indices of the splats from near to far; by default they are in that order.
        runs: of the whole grid, if known (`run_lengths`).
    """

    def __init__(
        self,
        arrays: Arrays,
        found: Boxed,
        grid: TileGrid,
        wanted: Bits | None = None,
        order: UInt | None = None,
        runs: tuple[UInt64, UInt] | None = None,
    ):
        self._arrays, self.found, self.grid = arrays, found, grid
        self.whole = TileWindow(0, 0, grid.columns, grid.rows)
        self.wanted, self._order, self._known = grid.mask(wanted), order, runs
        self._mask = None if wanted is None else uploaded(arrays.plain.Bool, self.wanted)

    @staticmethod
    def of(arrays: Arrays, splats: Splats, grid: TileGrid, found: Boxed | None = None) -> Candidates:
        """Those of splats in any order, without derivatives, for all tiles; boxed now unless they are."""
        found = found or _boxed(arrays, splats, everywhere(arrays, grid), grid.side)
        return Candidates(arrays, found, grid, None, depth_order(arrays, splats.depth, found.count > 0))

    def runs(self, window: TileWindow) -> Runs:
        """The candidates in a window, counted but not listed."""
        tiles = np.zeros_like(self.wanted)
        inside = slice(window.top, window.bottom), slice(window.left, window.right)
        tiles[inside] = self.wanted[inside]
        if not tiles.any():
            return Runs(tiles, 0)
        boxes, count, known = self.found.boxes, self.found.count, self._known
        if window != self.whole:
            boxes, count = _clipped(self._arrays, boxes, count, window)
            known = None
        end, count = known or _run_lengths(self._arrays, count, self._order)
        # Here, the host waits.
        return Runs(tiles, int(end[len(boxes) - 1]), PairRuns(boxes, self._order, end, count))

    def bins(self, runs: Runs) -> Bins:
        """The lists of a window's tiles from its runs."""
        arrays, grid, UInt = self._arrays, self.grid, self._arrays.plain.UInt
        if runs.of is None or not runs.pairs:
            none = [dr.zeros(UInt, 0) for _ in range(6)]
            ranges = dr.zeros(UInt, 2 * grid.columns * grid.rows + 2)
            empty = Lists(grid.numbers(arrays), 0, ranges, *none[:3])
            return Bins(arrays, grid, runs.wanted, empty, *none[3:])
        pairs, first = self.sorted(runs)
        owner = dr.arange(UInt, dr.width(first)) if self._order is None else self._order
        return Bins(arrays, grid, runs.wanted, _listed(arrays, pairs), first, runs.of.count, owner)

    def sorted(self, runs: Runs) -> tuple[SortedPairs, UInt]:
        """The candidates of runs with the indices that sort them, and the first one of each run."""
        arrays, tiles = self._arrays, self.grid.columns * self.grid.rows
        grid, size = self.grid.numbers(arrays), capacity(runs.pairs)
        key, splat, first = _keys(arrays, grid, runs.of, self._mask, arrays.constant(runs.pairs), size)
        # Not in a recording: on a card, Dr.Jit 1.5 ends the process when it replays a sort.
        sorting = arrays.argsort(key, tiles + 1)
        return SortedPairs(grid, tiles, size, key, splat, sorting), first


def depth_order(arrays: Arrays, depth: Float, seen: Bool) -> UInt:
    """Indices of splats from near to far, those that are not seen last.

    Depths that agree to one part in 100,000, beyond 32 octaves in 16,000, count as equal: the sort is stable.
    """
    Float, UInt = arrays.plain.Float, arrays.plain.UInt
    bits = lambda value: UInt(dr.reinterpret_array(UInt, value))  # noqa: E731
    # The bits of positive floats rise with their values; the upper ones are enough.
    steps = dr.select(seen, bits(dr.maximum(depth, NEAR)) - bits(Float(NEAR)), 0)
    last = (1 << _DEPTH_BITS) - 1
    shift, farthest = UInt(_DEPTH_SHIFT), dr.max(steps)
    for further in range(3):
        shift += dr.select(farthest >> (_DEPTH_SHIFT + further) >= last, UInt(1), 0)
    # Not a number is beyond all.
    return arrays.argsort(dr.select(seen, dr.minimum(steps >> shift, last - 1), last), last + 1)


def boxed(arrays: Arrays, splats: Splats, bounds: TileBounds, side: int) -> Boxed:
    """What is read of splats for tiles of that side, each confined to some tiles."""
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
    # With a number that is none, or infinite, a splat touches no tile: no weight keeps it from a pixel.
    numbers = reach_x + reach_y + splats.x + splats.y + splats.red + splats.green + splats.blue
    seen &= (x1 > x0) & (y1 > y0) & dr.isfinite(numbers)
    across, down = dr.select(seen, UInt(x1 - x0), 0), dr.select(seen, UInt(y1 - y0), 0)
    boxes = _packed_boxes(arrays, splats, UInt(x0), UInt(y0), across)
    return Boxed(packed(arrays, splats), boxes, across * down)


def packed(arrays: Arrays, splats: Splats) -> Records:
    """What the tiles read of splats."""
    # Powers of two cost less than powers of e, and the opacity joins the exponent as its logarithm.
    u_x = dr.sqrt(splats.x_precision * (0.5 * LOG2_E))
    same = {name: getattr(splats, name) for name in ("x", "y", "red", "green", "blue")}
    v_y = dr.sqrt(splats.y_precision * (0.5 * LOG2_E))
    constant = dr.log2(dr.maximum(splats.opacity, 1e-12))
    u_y = u_x * splats.shear
    return _BLENDED.pack(arrays, **same, u_x=u_x, u_y=u_y, v_y=v_y, constant=constant)


def _packed_boxes(
    arrays: Arrays, ellipse: Splats | SimpleNamespace, left: UInt, top: UInt, across: UInt
) -> Records:
    same = {name: getattr(ellipse, name) for name in _ELLIPSE}
    return _BOX.pack(arrays, **same, corner=left | top << 16, across=across)


def _clipped(arrays: Arrays, boxes: Records, count: UInt, window: TileWindow) -> tuple[Records, UInt]:
    """The parts of boxes with so many tiles each inside a window, and their numbers of tiles."""
    box = boxes.at(dr.arange(arrays.plain.UInt, len(boxes)))
    at_left, at_top = box.corner & 0xFFFF, box.corner >> 16
    left, top, right, bottom = (arrays.constant(side) for side in window)
    first_x, first_y = dr.maximum(at_left, left), dr.maximum(at_top, top)
    end_x = dr.minimum(at_left + box.across, right)
    end_y = dr.minimum(at_top + count // dr.maximum(box.across, 1), bottom)
    inside = (count > 0) & (end_x > first_x) & (end_y > first_y)
    across, down = dr.select(inside, end_x - first_x, 0), dr.select(inside, end_y - first_y, 0)
    records, tiles = _packed_boxes(arrays, box, first_x, first_y, across), across * down
    dr.eval(records.tables, tiles)
    return records, tiles


@dataclass(frozen=True)
class PairRuns:
    """The runs of candidates of S splats on the device."""

    boxes: Records  # of all splats
    order: UInt | None  # (S,) the splats; None for all of them as they are
    end: UInt64  # (S,) candidates up to the end of each one's run
    count: UInt  # (S,) candidates in it; some are empty


@dataclass(frozen=True)
class Runs:
    """Candidate pairs of splat and tile in a window: a run per splat, one tile after another."""

    wanted: Bits  # (rows, columns) the window's tiles that are rasterized
    pairs: int  # number of candidates
    of: PairRuns | None = None  # if there are any


def run_lengths(arrays: Arrays, count: UInt, order: UInt | None) -> tuple[UInt64, UInt]:
    """`end` and `count` of `PairRuns`, in 64 bits: there may be more pairs than 32 bits count."""
    if order is not None:
        count = dr.gather(arrays.plain.UInt, count, order)
    wide = arrays.plain.UInt64(count)
    # In one kernel with what the splats are packed into.
    dr.eval(wide, count)
    return dr.cumsum(wide), count


def keys(
    arrays: Arrays, grid: GridNumbers, runs: PairRuns, wanted: Bool | None, pairs: UInt, size: int
) -> tuple[UInt, UInt, UInt]:
    """For each of `size` candidates the key that it is sorted by and its splat; the first one of each run.

    The key is the number of the tile, or that of all tiles for a candidate that need not be drawn, and for
    what lies behind the last one. `wanted` is the mask of tiles, and `pairs` the number of candidates. Where
    there are more pairs than 32 bits count, first ones wrap: whoever asks must split the window.
    """
    UInt = arrays.plain.UInt
    # Mark the first pair of each run by the run's number: the largest so far tells whose run a pair lies in.
    marks, first = dr.zeros(UInt, size), UInt(runs.end) - runs.count
    dr.scatter(marks, dr.arange(UInt, dr.width(first)), first, runs.count > 0)
    dr.eval(marks, first)
    run = dr.prefix_reduce(dr.ReduceOp.Max, marks, exclusive=False)
    splat = run if runs.order is None else dr.gather(UInt, runs.order, run)
    box, lane = runs.boxes.at(splat), dr.arange(UInt, size)
    within = lane - dr.gather(UInt, first, run)
    # Masked lanes divide as well, and a division by zero raises SIGFPE on the CPU.
    across = dr.maximum(box.across, 1)
    row = within // across
    tile_x = (box.corner & 0xFFFF) + within - row * across
    tile_y = (box.corner >> 16) + row
    tile, keep = tile_y * grid.columns + tile_x, lane < pairs
    keep &= _reaches(arrays, box, tile_x, tile_y, grid.side)
    if wanted is not None:
        keep &= dr.gather(arrays.plain.Bool, wanted, tile, keep)
    key = dr.select(keep, tile, grid.tiles)
    dr.eval(key, splat)
    return key, splat, first


def _reaches(arrays: Arrays, splat: SimpleNamespace, tile_x: UInt, tile_y: UInt, side: int) -> Bool:
    """Whether a splat is visible anywhere between the outermost pixel centres of a tile.

    The largest value of the Gaussian over a rectangle lies at its centre or on one of the two edges next to
    the centre.
    """
    number = arrays.plain.Float
    left, top = number(tile_x * side) + 0.5 - splat.x, number(tile_y * side) + 0.5 - splat.y
    right, bottom = left + (side - 1), top + (side - 1)
    near_x, near_y = dr.clip(0, left, right), dr.clip(0, top, bottom)
    # Where the Gaussian is largest on a column, and on a row.
    # The least denominator keeps a round splat of extreme proportions, 0 / 0, from becoming NaN.
    ratio = splat.y_precision / splat.x_precision
    slope = -splat.shear / dr.maximum(dr.fma(splat.shear, splat.shear, ratio), 1e-37)
    along_y = dr.clip(slope * near_x, top, bottom)
    along_x = dr.clip(-splat.shear * near_y, left, right)

    def quadratic(u: Float, v: Float) -> Float:
        t = dr.fma(splat.shear, v, u)
        return splat.x_precision * t * t + splat.y_precision * v * v

    nearest = dr.minimum(quadratic(near_x, along_y), quadratic(along_x, near_y))
    # Slack for rounding: what is kept in excess here, the rasterizer tests pixel by pixel.
    return nearest <= 2 * dr.log(splat.opacity * (1 / MINIMUM_ALPHA)) + 1e-3


@dataclass(frozen=True)
class SortedPairs:
    """Candidates (P,) and the indices that sort them by tile; those of one tile keep their order."""

    grid: GridNumbers
    tiles: int
    pairs: int  # P
    key: UInt  # key, splat: (P,) as `keys` gives them
    splat: UInt
    sorting: UInt  # (P,) indices


def lists(arrays: Arrays, of: SortedPairs) -> Lists:
    """The lists of tiles; not evaluated."""
    UInt = arrays.plain.UInt
    # What no pair says: lists, also empty ones, end behind the last pair, and so do those to be blended.
    ranges = dr.full(UInt, of.pairs, 2 * (of.tiles + 1))
    lane = dr.arange(UInt, of.pairs)
    own = dr.gather(UInt, of.key, of.sorting)
    before = dr.gather(UInt, of.key, dr.gather(UInt, of.sorting, lane - 1, lane > 0), lane > 0)
    dr.scatter(ranges, lane, own * 2, (lane == 0) | (own != before))
    dr.scatter(ranges, lane, before * 2 + 1, (lane > 0) & (own != before))
    return Lists(of.grid, of.pairs, ranges, dr.gather(UInt, of.splat, of.sorting), own, of.sorting)


_boxed, _run_lengths = Frozen(boxed, by_size=True), Frozen(run_lengths, by_size=True)
_keys, _listed = Frozen(keys, by_size=True), Frozen(lists, by_size=True)
