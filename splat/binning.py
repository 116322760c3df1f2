"""Which splats touch which tiles, in the order of depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from splat.arrays import Arrays
from splat.project import Splats

# 16 x 16 pixels: with 4 x 4 pixels per lane the 16 lanes of a tile fill one AVX-512 vector and half a warp.
TILE = 16
# Below this a contribution is invisible on an 8-bit display; every extent follows from it.
MINIMUM_ALPHA = 1 / 255


@dataclass
class Bins:
    """The lists of splats that the tiles blend.

    Attributes:
        width, height: frame in pixels.
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
) -> Bins:
    """Sorts pairs of splat and tile by tile and depth.

    Args:
        arrays: the backend's array types.
        splats: N projected Gaussians, arrays without derivatives.
        width, height: frame in pixels.
        wanted: (rows, columns) bool, the tiles to rasterize; all by default.
        panels: the part of the frame that each splat is confined to; all of it by default.
    """
    Float, UInt = arrays.plain.Float, arrays.plain.UInt
    columns, rows = -(-width // TILE), -(-height // TILE)
    mask = np.ones((rows, columns), dtype=bool) if wanted is None else wanted
    if mask.shape != (rows, columns):
        raise ValueError(f"wanted has shape {mask.shape}, expected {(rows, columns)}")
    tiles = UInt(np.flatnonzero(mask).astype(np.uint32))

    x0, y0, across, down = _touched(arrays, splats, panels or Panels(columns, 0, rows))
    visible = dr.compress(across * down > 0)
    order = dr.gather(UInt, visible, dr.argsort(dr.gather(Float, splats.depth, visible)))
    count = dr.gather(UInt, across, order) * dr.gather(UInt, down, order)
    first = dr.prefix_sum(count)
    dr.eval(order, count, first)
    candidates = int(dr.sum(count)[0]) if dr.width(order) else 0
    if not candidates or not mask.any():
        none, empty = dr.zeros(UInt, 0), dr.zeros(UInt, columns * rows)
        return Bins(width, height, columns, rows, tiles, empty, empty, none, none, none, none, none, 0)

    # Which splat does pair number j belong to? Mark where each neighbourhood begins, and count the marks.
    marks = dr.zeros(UInt, candidates)
    dr.scatter(marks, UInt(1), first)
    rank = dr.cumsum(marks) - 1
    splat = dr.gather(UInt, order, rank)
    within = dr.arange(UInt, candidates) - dr.gather(UInt, first, rank)
    # Masked lanes divide too; a zero there raises SIGFPE on the CPU.
    pair_across = dr.maximum(dr.gather(UInt, across, splat), 1)
    pair_row = within // pair_across
    tile_x = dr.gather(UInt, x0, splat) + within - pair_row * pair_across
    tile_y = dr.gather(UInt, y0, splat) + pair_row
    tile = tile_y * columns + tile_x
    keep = _reaches(arrays, splats, splat, tile_x, tile_y)
    if wanted is not None:
        keep &= dr.gather(arrays.plain.Bool, arrays.plain.Bool(mask.ravel()), tile)
    key = dr.select(keep, tile, columns * rows)
    dr.eval(key, splat)

    sorting = dr.argsort(key)
    per_tile = dr.zeros(UInt, columns * rows + 1)
    dr.scatter_reduce(dr.ReduceOp.Add, per_tile, UInt(1), key)
    start = dr.prefix_sum(per_tile)
    end = start + per_tile
    sorted_splat = dr.gather(UInt, splat, sorting)
    dr.eval(sorted_splat, start, end)
    pairs = int(start[columns * rows])
    return Bins(
        width, height, columns, rows, tiles, start, end, sorted_splat, sorting, first, count, order, pairs
    )


def _touched(arrays: Arrays, splats: Splats, panels: Panels) -> tuple[Any, Any, Any, Any]:
    """First tile and number of tiles, along x and y, of the box around each splat's visible ellipse."""
    Int, UInt = arrays.plain.Int, arrays.plain.UInt
    # exp(-q / 2) opacity = 1/255 is the ellipse q = 2 ln(255 opacity); the covariance's diagonal bounds it.
    level = 2 * dr.log(dr.maximum(splats.opacity * (1 / MINIMUM_ALPHA), 1))
    inverse = dr.rcp(splats.xx * splats.yy - splats.xy * splats.xy)
    reach_x = dr.sqrt(level * splats.yy * inverse)
    reach_y = dr.sqrt(level * splats.xx * inverse)
    seen = splats.opacity > MINIMUM_ALPHA
    bound = lambda value, low, high: dr.clip(value * (1 / TILE), low, high)  # noqa: E731
    x0 = Int(dr.floor(bound(splats.x - reach_x, 0, panels.columns)))
    y0 = Int(dr.floor(bound(splats.y - reach_y, panels.top, panels.bottom)))
    x1 = Int(dr.ceil(bound(splats.x + reach_x, 0, panels.columns)))
    y1 = Int(dr.ceil(bound(splats.y + reach_y, panels.top, panels.bottom)))
    # A NaN compares false everywhere and so touches nothing.
    seen &= (x1 > x0) & (y1 > y0) & dr.isfinite(reach_x + reach_y + splats.x + splats.y)
    across, down = dr.select(seen, UInt(x1 - x0), 0), dr.select(seen, UInt(y1 - y0), 0)
    first_x, first_y = UInt(x0), UInt(y0)
    dr.eval(first_x, first_y, across, down)
    return first_x, first_y, across, down


def _reaches(arrays: Arrays, splats: Splats, splat: Any, tile_x: Any, tile_y: Any) -> Any:
    """Whether a splat is visible anywhere between the outermost pixel centres of a tile.

    The box of a long diagonal splat holds many tiles that its ellipse misses. The largest value of the
    Gaussian over a rectangle lies at its centre or on one of the two edges next to the centre.
    """
    Float = arrays.plain.Float
    x, y = dr.gather(Float, splats.x, splat), dr.gather(Float, splats.y, splat)
    xx, xy = dr.gather(Float, splats.xx, splat), dr.gather(Float, splats.xy, splat)
    yy, opacity = dr.gather(Float, splats.yy, splat), dr.gather(Float, splats.opacity, splat)
    left, top = Float(tile_x * TILE) + 0.5 - x, Float(tile_y * TILE) + 0.5 - y
    right, bottom = left + (TILE - 1), top + (TILE - 1)
    near_x, near_y = dr.clip(0, left, right), dr.clip(0, top, bottom)
    along_y = dr.clip(-xy * near_x / yy, top, bottom)
    along_x = dr.clip(-xy * near_y / xx, left, right)
    quadratic = lambda u, v: xx * u * u + 2 * xy * u * v + yy * v * v  # noqa: E731
    nearest = dr.minimum(quadratic(near_x, along_y), quadratic(along_x, near_y))
    # A little slack: what rounding might cut here, the rasterizer still tests pixel by pixel.
    return nearest <= 2 * dr.log(opacity * (1 / MINIMUM_ALPHA)) + 1e-3
