"""Lanes that own blocks of pixels, and the splats they read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from splat.base.arrays import Arrays
from splat.raster.binning import LANES_ACROSS, Bins
from splat.raster.blending import MINIMUM_TRANSMITTANCE
from splat.raster.projection import Splats

# A pixel's radiance and opacity lie side by side, so that they come with one load.
CHANNELS = 4
_LOG2_E = 1.4426950408889634
# The numbers of a splat lie side by side, eight and two, and come with two packet loads; loads of single
# floats from places that differ by lane are several times slower.
_PACKED = (8, 2)
# Floats of an image that a lane reads or writes at once: two pixels.
_CHUNK = 2 * CHANNELS
# Minimax polynomial of 2^f on -0.5..0.5, relative error 7.5e-8.
_EXP2 = (1.00000007, 0.69314697, 0.2402212, 0.05550713, 0.00967554, 0.00132765)
_ROUNDING = 12582912.0  # 1.5 * 2^23: adding it rounds a float to an integer in its low mantissa bits


class Blocks:
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


def pack(arrays: Arrays, splats: Splats, bins: Bins) -> tuple[Any, Any]:
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


def fetch(arrays: Arrays, packed: tuple[Any, Any], i: Any) -> list[Any]:
    """x, y, three coefficients of the exponent, log2 of the opacity, red, green, blue of pair i."""
    eight, two = (
        dr.gather(arrays.plain.ArrayXf, table, i, shape=(size, dr.width(i)))
        for size, table in zip(_PACKED, packed, strict=True)
    )
    return [*(eight[k] for k in range(_PACKED[0])), two[0]]


def powers(block: Blocks, splat: Sequence[Any]) -> list[tuple[int, Any]]:
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


def exp2(arrays: Arrays, power: Any) -> Any:
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
