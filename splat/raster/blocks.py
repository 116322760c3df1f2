"""Lanes that own blocks of pixels, and the splats that they read."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import drjit as dr

from compose.base.arrays import Arrays
from splat.raster.binning import Bins
from splat.raster.projection import Splats
from splat.raster.records import RecordLayout, Records
from splat.raster.tiles import LANES_ACROSS

# A block stops once every pixel transmits less: what lies behind changes them by at most this share of its
# radiance.
MINIMUM_TRANSMITTANCE = 1e-4
# A pixel of the image buffer. Nothing is spare.
PIXEL = RecordLayout((4,), red=1, green=1, blue=1, opacity=1)
CHANNELS = 4
# A splat as the tiles read it: centre, log2 of its alpha at (dx, dy) from there as constant - u^2 - v^2 with
# u = u_x dx + u_y dy and v = v_y dy, and radiance. One float is spare.
_BLENDED = RecordLayout((8, 2), x=1, y=1, u_x=1, u_y=1, v_y=1, constant=1, red=1, green=1, blue=1)
LOG2_E = 1.4426950408889634
# Floats of an image that a lane reads or writes at once: two pixels.
_CHUNK = 2 * CHANNELS
# Minimax polynomial of 2^f on -0.5..0.5, relative error 7.5e-8.
_EXP2 = (1.00000007, 0.69314697, 0.2402212, 0.05550713, 0.00967554, 0.00132765)
_ROUNDING = 12582912.0  # 1.5 * 2^23: adding it rounds a float to an integer in its low mantissa bits


class Blocks:
    """The lanes: one per block of pixels, the 16 blocks of a tile side by side.

    Args:
        arrays: the backend's array types.
        bins: the tiles and their lists.

    Attributes:
        side: of a block in pixels.
        pixels: in a block.
        x, y: each lane's first pixel.
        centre_x, centre_y: that pixel's centre.
        first, last: range of each lane in the lists; `last` is exclusive.
    """

    def __init__(self, arrays: Arrays, bins: Bins):
        Float, UInt = arrays.plain.Float, arrays.plain.UInt
        self._arrays = arrays
        self.side = bins.grid.side // LANES_ACROSS
        self.pixels = self.side**2
        lane = dr.arange(UInt, dr.width(bins.tiles) * LANES_ACROSS**2)
        tile = dr.gather(UInt, bins.tiles, lane // LANES_ACROSS**2)
        block = lane % LANES_ACROSS**2
        columns = arrays.number(bins.grid.columns)
        row = tile // columns
        self.x = (tile - row * columns) * bins.grid.side + block % LANES_ACROSS * self.side
        self.y = row * bins.grid.side + block // LANES_ACROSS * self.side
        self.centre_x, self.centre_y = Float(self.x) + 0.5, Float(self.y) + 0.5
        self.first = dr.gather(UInt, bins.start, tile)
        self.last = dr.gather(UInt, bins.end, tile)

    def is_active(self, i: Any, transmittance: Sequence[Any]) -> Any:
        """Whether splats are left and any pixel of the block still transmits light."""
        most = transmittance[0]
        for value in transmittance[1:]:
            most = dr.maximum(most, value)
        return (i < self.last) & (most > MINIMUM_TRANSMITTANCE)

    def log2_alphas(self, splat: SimpleNamespace) -> list[tuple[Any, Any, Any]]:
        """For each pixel of the block, row by row, log2 of a splat's alpha, not yet clamped, and its u and v.

        Whatever the size of the splat, u and v are less than 3 where it is visible.
        """
        columns = [splat.u_x * (self.centre_x + float(k) - splat.x) for k in range(self.side)]
        found = []
        for row in range(self.side):
            # What the pixels of a row have in common.
            dy = self.centre_y + float(row) - splat.y
            v, shift = splat.v_y * dy, splat.u_y * dy
            base = dr.fma(-v, v, splat.constant)
            for column in columns:
                u = column + shift
                found.append((dr.fma(-u, u, base), u, v))
        return found

    def chunks(self, width: int) -> list[tuple[Any, int]]:
        """The block's pixels by twos: position in an image in units of two pixels, and number of the first.

        Args:
            width: of the image in pixels.
        """
        columns = self._arrays.number(width)
        return [
            (((self.y + pixel // self.side) * columns + self.x + pixel % self.side) // 2, pixel)
            for pixel in range(0, self.pixels, 2)
        ]

    def loaded(self, image: Any, width: int) -> list[Any]:
        """Red, green, blue of each pixel of the block, from a flat image of that width in pixels."""
        values: list[Any] = []
        for target, _ in self.chunks(width):
            shape = (_CHUNK, dr.width(target))
            two = dr.gather(self._arrays.plain.ArrayXf, image, target, shape=shape)
            values += [two[k] for k in (0, 1, 2, CHANNELS, CHANNELS + 1, CHANNELS + 2)]
        return values


def blended_records(arrays: Arrays, splats: Splats, bins: Bins) -> Records:
    """The splats' numbers, one record per pair, in the order in which the tiles read them."""
    UInt = arrays.plain.UInt
    # Powers of two cost less than powers of e, and the opacity joins the exponent as its logarithm.
    u_x = dr.sqrt(splats.x_precision * (0.5 * LOG2_E))
    records = _BLENDED.pack(
        arrays,
        x=splats.x,
        y=splats.y,
        u_x=u_x,
        u_y=u_x * splats.shear,
        v_y=dr.sqrt(splats.y_precision * (0.5 * LOG2_E)),
        constant=dr.log2(dr.maximum(splats.opacity, 1e-12)),
        red=splats.red,
        green=splats.green,
        blue=splats.blue,
    )
    dr.eval(records.tables)
    per_pair = records.gathered(dr.gather(UInt, bins.splat, dr.arange(UInt, bins.pairs)))
    dr.eval(per_pair.tables)
    return per_pair


def exp2(arrays: Arrays, power: Any) -> Any:
    """2^power for power <= 0; 2^-16, far under the smallest alpha, for any power below -16."""
    Float, Int = arrays.plain.Float, arrays.plain.Int
    clamped = dr.maximum(power, -16.0)
    shifted = clamped + _ROUNDING
    fraction = clamped - (shifted - _ROUNDING)
    value = dr.fma(fraction, _EXP2[5], _EXP2[4])
    for coefficient in _EXP2[3::-1]:
        value = dr.fma(fraction, value, coefficient)
    exponent = dr.reinterpret_array(Int, shifted) << 23
    return dr.reinterpret_array(Float, dr.reinterpret_array(Int, value) + exponent)
