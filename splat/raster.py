"""Blends binned splats front to back, and the gradient of that, tile by tile.

One lane owns a block of pixels, 4 x 4 in tiles of 16, whose transmittance and colour live in the loop's
variables, so that each splat fetched from memory serves 16 pixels. Contribution of splat m to a pixel
(Fov-GS Eq. 1 without its normalization): c_m = alpha_m prod_{n<m} (1 - alpha_n),
alpha_m = min(0.99, opacity exp(-d^T Sigma'^-1 d / 2)), nothing below 1/255.

A block stops when all of its pixels have let through less than 1e-4: what lies behind could change
them by less than 1e-4 of its radiance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from splat.arrays import Arrays
from splat.binning import LANES_ACROSS, MINIMUM_ALPHA, Bins
from splat.project import Splats

# A pixel's radiance and opacity lie side by side, so that they come with one load.
CHANNELS = 4
MAXIMUM_ALPHA = 0.99
MINIMUM_TRANSMITTANCE = 1e-4
_LOG2_E = 1.4426950408889634
# The numbers of a splat lie side by side, eight and two, and come with two packet loads; loads of single
# floats from places that differ by lane are several times slower.
_PACKED = (8, 2)
# Floats of an image that a lane reads or writes at once: two pixels.
_CHUNK = 2 * CHANNELS
# Minimax polynomial of 2^f on -0.5..0.5, relative error 7.5e-8.
_EXP2 = (1.00000007, 0.69314697, 0.2402212, 0.05550713, 0.00967554, 0.00132765)
_ROUNDING = 12582912.0  # 1.5 * 2^23: adding it rounds a float to an integer in its low mantissa bits


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


def rasterize_backward(arrays: Arrays, splats: Splats, bins: Bins, image: Any, gradient: Any) -> list[Any]:
    """Gradients of a loss with respect to the splats.

    The list is walked front to back once more. With S the light that arrives from behind splat m,
    the final colour less all that was added up to m, d colour / d alpha_m = T_m c_m - S / (1 - alpha_m).

    Args:
        splats, bins, image: as given to and returned by `rasterize`.
        gradient: flat array like `image`, derivative of the loss by the radiance; that by the opacity is
            taken for zero.

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
    flow, final = block.loaded(gradient, width), block.loaded(image, width)
    behind = [sum(flow[3 * p + c] * final[3 * p + c] for c in range(3)) for p in range(block.pixels)]
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

    state = (block.first, [Float(1) for _ in range(block.pixels)], behind, slots)
    _, _, _, slots = dr.while_loop(
        state, lambda i, transmittance, behind, slots: block.goes_on(i, transmittance), walk, mode="symbolic"
    )
    dr.eval(slots)
    sums = _sum_neighbourhoods(arrays, bins, slots, count)
    return _from_moments(splats, sums)


class _Blocks:
    """The lanes: one per block of pixels, the 16 blocks of a tile side by side.

    Attributes:
        side, pixels: of a block.
    """

    def __init__(self, arrays: Arrays, bins: Bins):
        Float, UInt = arrays.plain.Float, arrays.plain.UInt
        self._arrays = arrays
        self.side = bins.tile // LANES_ACROSS
        self.pixels = self.side**2
        lane = dr.arange(UInt, dr.width(bins.tiles) * LANES_ACROSS**2)
        tile = dr.gather(UInt, bins.tiles, lane // LANES_ACROSS**2)
        block = lane % LANES_ACROSS**2
        columns = arrays.number(bins.columns)
        row = tile // columns
        self.x = (tile - row * columns) * bins.tile + block % LANES_ACROSS * self.side
        self.y = row * bins.tile + block // LANES_ACROSS * self.side
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
        dx = self.centre_x + float(pixel % self.side) - splat[0]
        return dx, self.centre_y + float(pixel // self.side) - splat[1]

    def chunks(self, width: int) -> list[tuple[Any, int]]:
        """Where the block's pixels lie in an image, by twos: in units of two, and the number of the first."""
        columns = self._arrays.number(width)
        return [
            (((self.y + pixel // self.side) * columns + self.x + pixel % self.side) // 2, pixel)
            for pixel in range(0, self.pixels, 2)
        ]

    def loaded(self, image: Any, width: int) -> list[Any]:
        """Three channels of the block's pixels, pixel by pixel, from an image."""
        values: list[Any] = []
        for target, _ in self.chunks(width):
            shape = (_CHUNK, dr.width(target))
            two = dr.gather(self._arrays.plain.ArrayXf, image, target, shape=shape)
            values += [two[k] for k in (0, 1, 2, CHANNELS, CHANNELS + 1, CHANNELS + 2)]
        return values


def _pack(arrays: Arrays, splats: Splats, bins: Bins) -> tuple[Any, Any]:
    """The splats' numbers in the order in which the tiles read them."""
    Float, UInt, ArrayXf = arrays.plain.Float, arrays.plain.UInt, arrays.plain.ArrayXf
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
        splats.blue,
        Float(0),
    ]
    count = dr.width(splats.x)
    parts = rows[: _PACKED[0]], rows[_PACKED[0] :]
    tables = [dr.empty(Float, size * count) for size in _PACKED]
    for table, part in zip(tables, parts, strict=True):
        dr.scatter(table, ArrayXf(part), dr.arange(UInt, count), mode=dr.ReduceMode.Permute)
    dr.eval(tables)
    packed = [dr.empty(Float, size * bins.pairs) for size in _PACKED]
    pair = dr.arange(UInt, bins.pairs)
    splat = dr.gather(UInt, bins.splat, pair)
    for size, table, target in zip(_PACKED, tables, packed, strict=True):
        values = dr.gather(ArrayXf, table, splat, shape=(size, bins.pairs))
        dr.scatter(target, values, pair, mode=dr.ReduceMode.Permute)
    dr.eval(packed)
    return packed[0], packed[1]


def _fetch(arrays: Arrays, packed: tuple[Any, Any], i: Any) -> list[Any]:
    """x, y, three coefficients of the exponent, log2 of the opacity, red, green, blue of pair i."""
    eight, two = (
        dr.gather(arrays.plain.ArrayXf, table, i, shape=(size, dr.width(i)))
        for size, table in zip(_PACKED, packed, strict=True)
    )
    return [*(eight[k] for k in range(_PACKED[0])), two[0]]


def _powers(block: _Blocks, splat: Sequence[Any]) -> list[tuple[int, Any]]:
    """For each pixel of the block, log2 of opacity times Gaussian; the row's share is computed once."""
    across = [block.offset(column, splat)[0] for column in range(block.side)]
    across_xx = [splat[2] * dx for dx in across]
    powers = []
    for row in range(block.side):
        dy = block.offset(row * block.side, splat)[1]
        base = dr.fma(splat[4] * dy, dy, splat[5])
        slope = splat[3] * dy
        for column in range(block.side):
            power = dr.fma(across[column], across_xx[column] + slope, base)
            powers.append((row * block.side + column, power))
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
    return buffer.numpy().reshape(height, width, CHANNELS)[: bins.height, : bins.width, :3]
