"""Blends binned splats front to back, tile by tile.

One lane owns a block of pixels, 4 x 4 in tiles of 16, whose transmittance and colour are loop variables:
each splat fetched from memory serves 16 pixels. Splat m contributes to a pixel
(Fov-GS Eq. 1 without its normalization): c_m = alpha_m prod_{n<m} (1 - alpha_n),
alpha_m = min(0.99, opacity exp(-d^T Sigma'^-1 d / 2)), or 0 where that is below 1/255.

A block stops once all of its pixels transmit less than 1e-4: what lies behind could change them by less
than 1e-4 of its radiance.

On the CPU, each lane goes by itself from one splat that its block shows to the next. On a GPU, lanes stay
together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from splat.raster.binning import MINIMUM_ALPHA, Bins
from splat.raster.blocks import CHANNELS, Blocks, Shown, blended_records, exp2
from splat.raster.projection import Splats
from splat.raster.tiles import TileGrid

MAXIMUM_ALPHA = 0.99
# To find out which blocks show a pair costs 1/40 of blending it. Where tiles have more pairs than this on
# average, blocks may well stop long before the end, and then it does not pay.
_LONG_LIST = 256


def rasterize(
    arrays: Arrays,
    splats: Splats,
    bins: Bins,
    images: list[Any] | None = None,
    heights: Sequence[int] | None = None,
) -> list[Any]:
    """Renders linear radiance and opacity of the wanted tiles; other tiles are 0.

    Args:
        arrays: the backend's array types.
        splats: without derivatives.
        bins: the tiles and their lists.
        images: what the tiles are drawn into; new images by default.
        heights: rows of tiles of each image, which lie one above the other; one of all rows by default.

    Returns:
        Flat Floats: padded height x padded width x 4, rows from the top.
    """
    Float, heights = arrays.plain.Float, heights or [bins.grid.rows]
    # New images need not be cleared: every tile has lanes, which leave it black where nothing is drawn.
    everywhere, listed = images is None, dr.width(bins.splat) > 0
    if images is None:
        images = new_images(arrays, bins.grid, heights, dr.empty if listed else dr.zeros)
    if not listed:
        return images
    records = blended_records(arrays, splats, bins)
    block = Blocks.of_tiles(arrays, bins, everywhere)
    shown = Shown(arrays, bins, records) if _jumps(arrays, bins) else None

    def following(i: Any) -> Any:
        return i if shown is None else shown.following(i, block.last, block.number)

    def blend(i: Any, transmittance: list[Any], colour: list[Any]) -> tuple[Any, list[Any], list[Any]]:
        splat = records.at(i)
        radiance = splat.red, splat.green, splat.blue
        transmittance, colour = list(transmittance), list(colour)
        for pixel, (power, _, _) in enumerate(block.log2_alphas(splat)):
            alpha = dr.minimum(exp2(arrays, power), MAXIMUM_ALPHA)
            alpha = dr.select(alpha >= MINIMUM_ALPHA, alpha, 0)
            weight = alpha * transmittance[pixel]
            for c in range(3):
                colour[3 * pixel + c] = dr.fma(weight, radiance[c], colour[3 * pixel + c])
            transmittance[pixel] = transmittance[pixel] - weight
        return following(i + 1), transmittance, colour

    # Built one by one: [Float(0)] * n would be a single accumulator n times.
    state = (
        following(block.first),
        [Float(1) for _ in range(block.pixels)],
        [Float(0) for _ in range(3 * block.pixels)],
    )
    _, transmittance, colour = dr.while_loop(
        state, lambda i, transmittance, colour: block.is_active(i, transmittance), blend, mode="symbolic"
    )
    pixels = [[*colour[3 * p : 3 * p + 3], 1 - transmittance[p]] for p in range(block.pixels)]
    side, width, within = bins.grid.side, bins.grid.padded_width, [True]
    # Rows of pixels, and chunks, above each image and in all.
    above = np.cumsum([0, *heights]) * side
    if len(images) > 1:
        rows = [arrays.constant(row) for row in above.tolist()]
        within = [(block.y >= top) & (block.y < bottom) for top, bottom in pairwise(rows)]
    before = [arrays.constant(chunks) if chunks else 0 for chunks in (above[:-1] * (width // 2)).tolist()]
    for target, first in block.chunks(width):
        values = arrays.plain.ArrayXf([*pixels[first], *pixels[first + 1]])
        for image, own, start in zip(images, within, before, strict=True):
            dr.scatter(image, values, target - start, own, mode=dr.ReduceMode.Permute)
    dr.eval(images)
    return images


def new_images(arrays: Arrays, grid: TileGrid, heights: Sequence[int], make: Callable[..., Any]) -> list[Any]:
    """Images of so many rows of a grid's tiles, made by `dr.zeros` or `dr.empty`."""
    row = grid.side * grid.padded_width * CHANNELS
    return [make(arrays.plain.Float, height * row) for height in heights]


def _jumps(arrays: Arrays, bins: Bins) -> bool:
    """Whether lanes go by themselves."""
    pairs, tiles = dr.width(bins.splat), int(np.count_nonzero(bins.wanted))
    return arrays.backend == "llvm" and pairs <= _LONG_LIST * tiles
