"""Which splats touch which tiles, in the order of depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from splat.base.arrays import Arrays
from splat.raster.projection import NEAR, Splats

# The 16 lanes of a tile fill one AVX-512 vector and half a warp.
LANES_ACROSS = 4
# 16 x 16 pixels, 4 x 4 per lane: the more pixels a splat covers, the more a large tile saves.
TILE = 16
_DEPTH_BITS = 22  # from the near plane they reach over 32 octaves
# Below this a contribution is invisible on an 8-bit display; every extent follows from it.
MINIMUM_ALPHA = 1 / 255


@dataclass
class Bins:
    """The lists of splats that the tiles blend.

    Attributes:
        width, height: frame in pixels.
        tile: side of a tile in pixels.
        columns, rows: tiles per row and column.
        tiles: (T,) indices of the tiles that are rasterized.
        start, end: (columns * rows,) range of each tile in the lists.
        splat: (P,) splat of each pair, sorted by tile, then by depth.
        home: (P,) position that each pair had before sorting, where the pairs of a splat are neighbours.
        first, count: (S,) that neighbourhood, for each of the S splats that have one.
        owner: (S,) index of those splats.
        pairs: P, pairs that no tile blends left out.
    """

    width: int
    height: int
    tile: int
    columns: int
    rows: int
    tiles: Any
    start: Any
    end: Any
    splat: Any
    home: Any
    first: Any
    count: Any
    owner: Any
    pairs: int


@dataclass
class Panels:
    """Where each splat may be drawn, when a frame is made of several pictures one below the other.

    Attributes:
        columns: (N,) tiles from the left edge, the width of the splat's picture.
        top, bottom: (N,) its first row of tiles, and the one after its last.
    """

    columns: Any
    top: Any
    bottom: Any


def bin_splats(
    arrays: Arrays,
    splats: Splats,
    width: int,
    height: int,
    wanted: np.ndarray | None = None,
    panels: Panels | None = None,
    tile: int = TILE,
    in_order: bool = False,
) -> Bins:
    """Sorts pairs of splat and tile by tile and depth.

    Args:
        arrays: the backend's array types.
        splats: N projected Gaussians, arrays without derivatives.
        width, height: frame in pixels.
        wanted: (rows, columns) bool, the tiles to rasterize; all by default.
        panels: the part of the frame that each splat is confined to; all of it by default.
        tile: side of a tile in pixels, a multiple of 4.
        in_order: whether splats that meet in a tile come from near to far already.
    """
    Float, UInt = arrays.plain.Float, arrays.plain.UInt
    columns, rows = -(-width // tile), -(-height // tile)
    mask = np.ones((rows, columns), dtype=bool) if wanted is None else wanted
    if mask.shape != (rows, columns):
        raise ValueError(f"wanted has shape {mask.shape}, expected {(rows, columns)}")
    tiles = UInt(np.flatnonzero(mask).astype(np.uint32))

    everywhere = Panels(arrays.number(columns), 0, arrays.number(rows))
    x0, y0, across, down = _touched(arrays, splats, panels or everywhere, tile)
    order = dr.compress(across > 0) if in_order else by_depth(arrays, splats.depth, across > 0)
    none, empty = dr.zeros(UInt, 0), dr.zeros(UInt, columns * rows)
    nothing = Bins(width, height, tile, columns, rows, tiles, empty, empty, none, none, none, none, none, 0)
    if not dr.width(order) or not mask.any():
        return nothing
    count = dr.gather(UInt, across, order) * dr.gather(UInt, down, order)
    first = dr.prefix_sum(count)
    shape = [splats.x, splats.y, splats.xx, splats.xy, splats.yy, splats.opacity]
    bits = lambda number: dr.reinterpret_array(Float, number)  # noqa: E731
    table = arrays.records([*shape, bits(x0 | y0 << 16), bits(across)])
    ranked = arrays.records([bits(order), bits(first)])
    candidates_of = dr.sum(count)
    dr.eval(order, count, first, table, ranked, candidates_of)
    candidates = int(candidates_of[0])
    if not candidates:
        return nothing

    # Which splat does pair number j belong to? Mark where each neighbourhood begins, and count the marks.
    marks = dr.zeros(UInt, candidates)
    dr.scatter(marks, UInt(1), first, count > 0)
    rank = dr.cumsum(marks) - 1
    splat, begin = (dr.reinterpret_array(UInt, n) for n in arrays.record(ranked, rank, 2))
    *shape, corner, across = arrays.record(table, splat, 8)
    within = dr.arange(UInt, candidates) - begin
    # Masked lanes divide too; a zero there raises SIGFPE on the CPU.
    pair_across = dr.maximum(dr.reinterpret_array(UInt, across), 1)
    pair_row = within // pair_across
    pair_corner = dr.reinterpret_array(UInt, corner)
    tile_x = (pair_corner & 0xFFFF) + within - pair_row * pair_across
    tile_y = (pair_corner >> 16) + pair_row
    number = tile_y * arrays.number(columns) + tile_x
    keep = _reaches(arrays, shape, tile_x, tile_y, tile)
    if wanted is not None:
        keep &= dr.gather(arrays.plain.Bool, arrays.plain.Bool(mask.ravel()), number)
    key = dr.select(keep, number, arrays.number(columns * rows))
    dr.eval(key, splat)

    sorting = arrays.sorting(key, columns * rows + 1)
    per_tile = dr.zeros(UInt, columns * rows + 1)
    dr.scatter_reduce(dr.ReduceOp.Add, per_tile, UInt(1), key)
    start = dr.prefix_sum(per_tile)
    end = start + per_tile
    sorted_splat = dr.gather(UInt, splat, sorting)
    dr.eval(sorted_splat, start, end)
    pairs = int(start[columns * rows])
    return Bins(
        width,
        height,
        tile,
        columns,
        rows,
        tiles,
        start,
        end,
        sorted_splat,
        sorting,
        first,
        count,
        order,
        pairs,
    )


def by_depth(arrays: Arrays, depth: Any, seen: Any) -> Any:
    """Indices of splats from near to far, those that are not seen last.

    Depths count as equal, and keep the order of their indices, where they agree to one part in 100,000.
    """
    bits = lambda value: dr.reinterpret_array(arrays.plain.UInt, value)  # noqa: E731
    # The bits of positive floats rise with them; the upper ones are enough.
    steps = bits(dr.maximum(depth, NEAR)) - bits(arrays.plain.Float(NEAR))
    last = (1 << _DEPTH_BITS) - 1
    return arrays.sorting(dr.select(seen, dr.minimum(steps >> 6, last - 1), last), last + 1)


def _touched(arrays: Arrays, splats: Splats, panels: Panels, tile: int) -> tuple[Any, Any, Any, Any]:
    """First tile and number of tiles, along x and y, of the box around each splat's visible ellipse."""
    Int, UInt = arrays.plain.Int, arrays.plain.UInt
    # exp(-q / 2) opacity = 1/255 is the ellipse q = 2 ln(255 opacity); the covariance's diagonal bounds it.
    level = 2 * dr.log(dr.maximum(splats.opacity * (1 / MINIMUM_ALPHA), 1))
    inverse = dr.rcp(splats.xx * splats.yy - splats.xy * splats.xy)
    reach_x = dr.sqrt(level * splats.yy * inverse)
    reach_y = dr.sqrt(level * splats.xx * inverse)
    seen = splats.opacity > MINIMUM_ALPHA
    bound = lambda value, low, high: dr.clip(value * (1 / tile), low, high)  # noqa: E731
    x0 = Int(dr.floor(bound(splats.x - reach_x, 0, panels.columns)))
    y0 = Int(dr.floor(bound(splats.y - reach_y, panels.top, panels.bottom)))
    x1 = Int(dr.ceil(bound(splats.x + reach_x, 0, panels.columns)))
    y1 = Int(dr.ceil(bound(splats.y + reach_y, panels.top, panels.bottom)))
    # A NaN compares false everywhere and so touches nothing.
    seen &= (x1 > x0) & (y1 > y0) & dr.isfinite(reach_x + reach_y + splats.x + splats.y)
    across, down = dr.select(seen, UInt(x1 - x0), 0), dr.select(seen, UInt(y1 - y0), 0)
    first_x, first_y = UInt(x0), UInt(y0)
    # With the splats themselves, if they are not yet: then it is one kernel.
    dr.eval(splats.__dict__, first_x, first_y, across, down)
    return first_x, first_y, across, down


def _reaches(arrays: Arrays, shape: list[Any], tile_x: Any, tile_y: Any, tile: int) -> Any:
    """Whether a splat is visible anywhere between the outermost pixel centres of a tile.

    The box of a long diagonal splat holds many tiles that its ellipse misses. The largest value of the
    Gaussian over a rectangle lies at its centre or on one of the two edges next to the centre.
    """
    Float = arrays.plain.Float
    x, y, xx, xy, yy, opacity = shape
    left, top = Float(tile_x * tile) + 0.5 - x, Float(tile_y * tile) + 0.5 - y
    right, bottom = left + (tile - 1), top + (tile - 1)
    near_x, near_y = dr.clip(0, left, right), dr.clip(0, top, bottom)
    along_y = dr.clip(-xy * near_x / yy, top, bottom)
    along_x = dr.clip(-xy * near_y / xx, left, right)
    quadratic = lambda u, v: xx * u * u + 2 * xy * u * v + yy * v * v  # noqa: E731
    nearest = dr.minimum(quadratic(near_x, along_y), quadratic(along_x, near_y))
    # A little slack: what rounding might cut here, the rasterizer still tests pixel by pixel.
    return nearest <= 2 * dr.log(opacity * (1 / MINIMUM_ALPHA)) + 1e-3
