"""Blends binned splats front to back, and the gradient of that, tile by tile.

One lane owns a block of pixels, 4 x 4 in tiles of 16, whose transmittance and colour live in the loop's
variables, so that each splat fetched from memory serves 16 pixels. Contribution of splat m to a pixel
(Fov-GS Eq. 1 without its normalization): c_m = alpha_m prod_{n<m} (1 - alpha_n),
alpha_m = min(0.99, opacity exp(-d^T Sigma'^-1 d / 2)), nothing below 1/255.

A block stops when all of its pixels have let through less than 1e-4: what lies behind could change
them by less than 1e-4 of its radiance.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from splat.base.arrays import Arrays
from splat.raster.binning import MINIMUM_ALPHA, Bins
from splat.raster.blocks import CHANNELS, Blocks, exp2, fetch, pack, powers
from splat.raster.projection import Splats

MAXIMUM_ALPHA = 0.99
MINIMUM_TRANSMITTANCE = 1e-4


def padded_size(bins: Bins) -> tuple[int, int]:
    """Width and height of the image buffer: whole tiles."""
    return bins.columns * bins.tile, bins.rows * bins.tile


def rasterize(arrays: Arrays, splats: Splats, bins: Bins) -> Any:
    """Linear radiance and opacity of all wanted tiles; the others hold zeros.

    Returns:
        Flat float array: padded height x padded width x 4, rows from the top.
    """
    Float = arrays.plain.Float
    width, height = padded_size(bins)
    if not bins.pairs:
        return dr.zeros(Float, width * height * CHANNELS)
    # Where every tile is drawn there is nothing to clear.
    all_drawn = dr.width(bins.tiles) == bins.columns * bins.rows
    image = (dr.empty if all_drawn else dr.zeros)(Float, width * height * CHANNELS)
    block = Blocks(arrays, bins)
    packed = pack(arrays, splats, bins)

    def blend(i: Any, transmittance: list[Any], colour: list[Any]) -> tuple[Any, list[Any], list[Any]]:
        splat = fetch(arrays, packed, i)
        transmittance, colour = list(transmittance), list(colour)
        for pixel, power in powers(block, splat):
            alpha = dr.minimum(exp2(arrays, power), MAXIMUM_ALPHA)
            alpha = dr.select(alpha >= MINIMUM_ALPHA, alpha, 0)
            weight = alpha * transmittance[pixel]
            for c in range(3):
                colour[3 * pixel + c] = dr.fma(weight, splat[6 + c], colour[3 * pixel + c])
            transmittance[pixel] = transmittance[pixel] - weight
        return i + 1, transmittance, colour

    # Built one by one: [Float(0)] * n would be a single accumulator n times.
    state = (
        block.first,
        [Float(1) for _ in range(block.pixels)],
        [Float(0) for _ in range(3 * block.pixels)],
    )
    _, transmittance, colour = dr.while_loop(
        state, lambda i, transmittance, colour: block.goes_on(i, transmittance), blend, mode="symbolic"
    )
    # Evaluated before it is scattered: otherwise every scatter runs the whole loop again.
    dr.eval(transmittance, colour)
    pixels = [[*colour[3 * p : 3 * p + 3], 1 - transmittance[p]] for p in range(block.pixels)]
    for target, first in block.chunks(width):
        values = arrays.plain.ArrayXf([*pixels[first], *pixels[first + 1]])
        dr.scatter(image, values, target, mode=dr.ReduceMode.Permute)
    dr.eval(image)
    return image


def image_from_buffer(buffer: Any, bins: Bins) -> np.ndarray:
    """(H, W, 3) float32 view of a flat image buffer."""
    width, height = padded_size(bins)
    return buffer.numpy().reshape(height, width, CHANNELS)[: bins.height, : bins.width, :3]
