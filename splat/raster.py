"""Blends binned splats front to back, and the gradient of that, tile by tile.

One lane owns a block of 4 x 4 pixels whose transmittance and colour live in the loop's variables, so
that each splat fetched from memory serves 16 pixels. Contribution of splat m to a pixel (Fov-GS Eq. 1
without its normalization): c_m = alpha_m prod_{n<m} (1 - alpha_n),
alpha_m = min(0.99, opacity exp(-d^T Sigma'^-1 d / 2)), nothing below 1/255.

A block stops when all of its pixels have let through less than 1e-4: what lies behind could change
them by less than 1e-4 of its radiance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import numpy as np

from splat.arrays import Arrays
from splat.binning import MINIMUM_ALPHA, TILE, Bins
from splat.project import Splats

BLOCK = 4
_BLOCKS_PER_TILE = (TILE // BLOCK) ** 2
_PIXELS = BLOCK * BLOCK
MAXIMUM_ALPHA = 0.99
MINIMUM_TRANSMITTANCE = 1e-4
_LOG2_E = 1.4426950408889634
# Eight numbers of a splat lie side by side and come with one packet load; blue comes on its own.
_PACKED = 8
# Minimax polynomial of 2^f on -0.5..0.5, relative error 7.5e-8.
_EXP2 = (1.00000007, 0.69314697, 0.2402212, 0.05550713, 0.00967554, 0.00132765)
_ROUNDING = 12582912.0  # 1.5 * 2^23: adding it rounds a float to an integer in its low mantissa bits


def padded_size(bins: Bins) -> tuple[int, int]:
    """Width and height of the image buffer: whole tiles."""
    return bins.columns * TILE, bins.rows * TILE


def rasterize(arrays: Arrays, splats: Splats, bins: Bins) -> Any:
    """Linear radiance of all wanted tiles; the others are black.

    Returns:
        Flat float array: padded height x padded width x 3, rows from the top.
    """
    Float = arrays.plain.Float
    width, height = padded_size(bins)
    image = dr.zeros(Float, width * height * 3)
    if not bins.pairs:
        dr.eval(image)
        return image
    block = _Blocks(arrays, bins)
    packed = _pack(arrays, splats, bins)

    def blend(i: Any, transmittance: list[Any], colour: list[Any]) -> tuple[Any, list[Any], list[Any]]:
        splat = _fetch(arrays, packed, i)
        transmittance, colour = list(transmittance), list(colour)
        for pixel, power in _powers(block, splat):
            alpha = dr.minimum(_exp2(arrays, power), MAXIMUM_ALPHA)
            alpha = dr.select(alpha >= MINIMUM_ALPHA, alpha, 0)
            weight = alpha * transmittance[pixel]
            for c in range(3):
                colour[3 * pixel + c] = dr.fma(weight, splat[6 + c], colour[3 * pixel + c])
            transmittance[pixel] = transmittance[pixel] - weight
        return i + 1, transmittance, colour

    # Built one by one: [Float(0)] * n would be a single accumulator n times.
    state = (block.first, [Float(1) for _ in range(_PIXELS)], [Float(0) for _ in range(3 * _PIXELS)])
    _, _, colour = dr.while_loop(
        state, lambda i, transmittance, colour: block.goes_on(i, transmittance), blend, mode="symbolic"
    )
    # Evaluated before it is scattered: otherwise every scatter runs the whole loop again.
    dr.eval(colour)
    for target, chunk in block.chunks(width):
        values = arrays.plain.ArrayXf([colour[4 * chunk + k] for k in range(4)])
        dr.scatter(image, values, target, mode=dr.ReduceMode.Permute)
    dr.eval(image)
    return image


def rasterize_backward(arrays: Arrays, splats: Splats, bins: Bins, image: Any, gradient: Any) -> list[Any]:
    """Gradients of a loss with respect to the splats.

    The list is walked front to back once more. With S the light that arrives from behind splat m,
    the final colour less all that was added up to m, d colour / d alpha_m = T_m c_m - S / (1 - alpha_m).

    Args:
        splats, bins, image: as given to and returned by `rasterize`.
        gradient: flat array like `image`, derivative of the loss by it.

    Returns:
        Nine (N,) arrays in the order of `Splats.differentiable`.
    """
    Float, UInt = arrays.plain.Float, arrays.plain.UInt
    count = dr.width(splats.x)
    if not bins.pairs:
        return [dr.zeros(Float, count) for _ in range(9)]
    width, _ = padded_size(bins)
    block = _Blocks(arrays, bins)
    packed = _pack(arrays, splats, bins)
    flow = _chunks_to_pixels(block, width, lambda target: _load4(arrays, gradient, target))
    final = _chunks_to_pixels(block, width, lambda target: _load4(arrays, image, target))
    behind = [sum(flow[3 * p + c] * final[3 * p + c] for c in range(3)) for p in range(_PIXELS)]
    dr.eval(flow, behind)
    # One slot per pair and quantity. All lanes of a tile reach a pair together and sum in their vector,
    # so that nothing here depends on the timing of threads.
    slots = [dr.zeros(Float, dr.width(bins.splat)) for _ in range(9)]

    def walk(i: Any, transmittance: list[Any], behind: list[Any], slots: list[Any]) -> tuple[Any, ...]:
        splat = _fetch(arrays, packed, i)
        transmittance, behind = list(transmittance), list(behind)
        # Sums over the block's pixels: of dL/dpower times 1, dx, dy, dx^2, dx dy, dy^2, and of
        # the weights times dL/dcolour.
        moments = [Float(0) for _ in range(6)]
        colours = [Float(0) for _ in range(3)]
        for pixel, power in _powers(block, splat):
            unclamped = _exp2(arrays, power)
            alpha = dr.minimum(unclamped, MAXIMUM_ALPHA)
            seen = alpha >= MINIMUM_ALPHA
            alpha = dr.select(seen, alpha, 0)
            weight = alpha * transmittance[pixel]
            here = flow[3 * pixel : 3 * pixel + 3]
            own = sum(here[c] * splat[6 + c] for c in range(3))
            behind[pixel] = dr.fma(-weight, own, behind[pixel])
            by_alpha = dr.fma(transmittance[pixel], own, -behind[pixel] * dr.rcp(1 - alpha))
            by_power = dr.select(seen & (unclamped < MAXIMUM_ALPHA), by_alpha * alpha, 0)
            transmittance[pixel] = transmittance[pixel] - weight
            dx, dy = block.offset(pixel, splat)
            along_x, along_y = by_power * dx, by_power * dy
            for k, term in enumerate((by_power, along_x, along_y)):
                moments[k] = moments[k] + term
            moments[3] = dr.fma(along_x, dx, moments[3])
            moments[4] = dr.fma(along_x, dy, moments[4])
            moments[5] = dr.fma(along_y, dy, moments[5])
            for c in range(3):
                colours[c] = dr.fma(weight, here[c], colours[c])
        home = dr.gather(UInt, bins.home, i)
        for slot, value in zip(slots, moments + colours, strict=True):
            dr.scatter_reduce(dr.ReduceOp.Add, slot, value, home, mode=dr.ReduceMode.Local)
        return i + 1, transmittance, behind, slots

    state = (block.first, [Float(1) for _ in range(_PIXELS)], behind, slots)
    _, _, _, slots = dr.while_loop(
        state, lambda i, transmittance, behind, slots: block.goes_on(i, transmittance), walk, mode="symbolic"
    )
    dr.eval(slots)
    sums = _sum_neighbourhoods(arrays, bins, slots, count)
    return _from_moments(splats, sums)


class _Blocks:
    """The lanes: one per block of 4 x 4 pixels, the 16 blocks of a tile side by side."""

    def __init__(self, arrays: Arrays, bins: Bins):
        Float, UInt = arrays.plain.Float, arrays.plain.UInt
        lane = dr.arange(UInt, dr.width(bins.tiles) * _BLOCKS_PER_TILE)
        tile = dr.gather(UInt, bins.tiles, lane // _BLOCKS_PER_TILE)
        block = lane % _BLOCKS_PER_TILE
        row = tile // bins.columns
        per_side = TILE // BLOCK
        self.x = (tile - row * bins.columns) * TILE + block % per_side * BLOCK
        self.y = row * TILE + block // per_side * BLOCK
        self.centre_x, self.centre_y = Float(self.x) + 0.5, Float(self.y) + 0.5
        self.first = dr.gather(UInt, bins.start, tile)
        self.last = dr.gather(UInt, bins.end, tile)

    def goes_on(self, i: Any, transmittance: Sequence[Any]) -> Any:
        """Whether any pixel of the block still lets light through, and splats are left."""
        most = transmittance[0]
        for value in transmittance[1:]:
            most = dr.maximum(most, value)
        return (i < self.last) & (most > MINIMUM_TRANSMITTANCE)

    def offset(self, pixel: int, splat: Sequence[Any]) -> tuple[Any, Any]:
        """From the splat's centre to the centre of the block's pixel."""
        dx = self.centre_x + float(pixel % BLOCK) - splat[0]
        return dx, self.centre_y + float(pixel // BLOCK) - splat[1]

    def chunks(self, width: int) -> list[tuple[Any, int]]:
        """Where each run of four floats of the block's 48 lies in the image, in units of four floats."""
        per_row = BLOCK * 3 // 4
        return [
            (((self.y + row) * width + self.x) * 3 // 4 + part, row * per_row + part)
            for row in range(BLOCK)
            for part in range(per_row)
        ]


def _chunks_to_pixels(block: _Blocks, width: int, load: Callable[[Any], Any]) -> list[Any]:
    """The block's 48 floats, pixel by pixel, from an image read by fours."""
    values: list[Any] = []
    for target, _ in block.chunks(width):
        values += list(load(target))
    return values


def _load4(arrays: Arrays, source: Any, index: Any) -> Any:
    return dr.gather(arrays.plain.ArrayXf, source, index, shape=(4, dr.width(index)))


def _pack(arrays: Arrays, splats: Splats, bins: Bins) -> tuple[Any, Any]:
    """Splats in the order in which the tiles read them: eight floats per pair, and blue."""
    Float, UInt = arrays.plain.Float, arrays.plain.UInt
    # Powers of two cost less than powers of e, and the opacity joins the exponent as its logarithm.
    rows = [
        splats.x,
        splats.y,
        splats.xx * (-0.5 * _LOG2_E),
        splats.xy * -_LOG2_E,
        splats.yy * (-0.5 * _LOG2_E),
        dr.log2(dr.maximum(splats.opacity, 1e-12)),
        splats.red,
        splats.green,
    ]
    table = dr.empty(Float, _PACKED * dr.width(splats.x))
    dr.scatter(
        table, arrays.plain.ArrayXf(rows), dr.arange(UInt, dr.width(splats.x)), mode=dr.ReduceMode.Permute
    )
    dr.eval(table)
    packed = dr.empty(Float, _PACKED * bins.pairs)
    pair = dr.arange(UInt, bins.pairs)
    splat = dr.gather(UInt, bins.splat, pair)
    values = dr.gather(arrays.plain.ArrayXf, table, splat, shape=(_PACKED, bins.pairs))
    dr.scatter(packed, values, pair, mode=dr.ReduceMode.Permute)
    blue = dr.gather(Float, splats.blue, splat)
    dr.eval(packed, blue)
    return packed, blue


def _fetch(arrays: Arrays, packed: tuple[Any, Any], i: Any) -> list[Any]:
    """x, y, three coefficients of the exponent, log2 of the opacity, red, green, blue of pair i."""
    eight = dr.gather(arrays.plain.ArrayXf, packed[0], i, shape=(_PACKED, dr.width(i)))
    return [*(eight[k] for k in range(_PACKED)), dr.gather(arrays.plain.Float, packed[1], i)]


def _powers(block: _Blocks, splat: Sequence[Any]) -> list[tuple[int, Any]]:
    """For each pixel of the block, log2 of opacity times Gaussian; the row's share is computed once."""
    across = [block.offset(column, splat)[0] for column in range(BLOCK)]
    across_xx = [splat[2] * dx for dx in across]
    powers = []
    for row in range(BLOCK):
        dy = block.offset(row * BLOCK, splat)[1]
        base = dr.fma(splat[4] * dy, dy, splat[5])
        slope = splat[3] * dy
        for column in range(BLOCK):
            power = dr.fma(across[column], across_xx[column] + slope, base)
            powers.append((row * BLOCK + column, power))
    return powers


def _exp2(arrays: Arrays, power: Any) -> Any:
    """2^power for power <= 0; below 2^-16, far under the smallest alpha, it is cut off there."""
    Float, Int = arrays.plain.Float, arrays.plain.Int
    clamped = dr.maximum(power, -16.0)
    shifted = clamped + _ROUNDING
    fraction = clamped - (shifted - _ROUNDING)
    value = dr.fma(fraction, _EXP2[5], _EXP2[4])
    for coefficient in _EXP2[3::-1]:
        value = dr.fma(fraction, value, coefficient)
    exponent = dr.reinterpret_array(Int, shifted) << 23
    return dr.reinterpret_array(Float, dr.reinterpret_array(Int, value) + exponent)


def _sum_neighbourhoods(arrays: Arrays, bins: Bins, slots: list[Any], count: int) -> list[Any]:
    """Sums each splat's pairs, neighbours before sorting, always in the same order."""
    Float, UInt = arrays.plain.Float, arrays.plain.UInt

    def add(i: Any, sums: list[Any]) -> tuple[Any, list[Any]]:
        return i + 1, [s + dr.gather(Float, slot, i) for s, slot in zip(sums, slots, strict=True)]

    end = bins.first + bins.count
    state = (UInt(bins.first), [dr.zeros(Float, dr.width(bins.first)) for _ in slots])
    _, sums = dr.while_loop(state, lambda i, sums: i < end, add, mode="symbolic")
    dr.eval(sums)
    totals = []
    for values in sums:
        total = dr.zeros(Float, count)
        dr.scatter(total, values, bins.owner, mode=dr.ReduceMode.Permute)
        totals.append(total)
    dr.eval(totals)
    return totals


def _from_moments(splats: Splats, sums: list[Any]) -> list[Any]:
    """Gradients by the splats' own parameters from the sums of dL/dpower; power = ln alpha."""
    s, sx, sy, sxx, sxy, syy, red, green, blue = sums
    gradients = [
        splats.xx * sx + splats.xy * sy,
        splats.xy * sx + splats.yy * sy,
        -0.5 * sxx,
        -sxy,
        -0.5 * syy,
        dr.select(splats.opacity > 0, s * dr.rcp(dr.maximum(splats.opacity, 1e-12)), 0),
        red,
        green,
        blue,
    ]
    dr.eval(gradients)
    return gradients


def image_from_buffer(buffer: Any, bins: Bins) -> np.ndarray:
    """(H, W, 3) float32 view of a flat image buffer."""
    width, height = padded_size(bins)
    return buffer.numpy().reshape(height, width, 3)[: bins.height, : bins.width]
