"""Lanes that own blocks of pixels, and the splats that they read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from types import SimpleNamespace
from typing import TYPE_CHECKING

import drjit as dr

from compose.base.arrays import Arrays
from splat.raster.binning import MINIMUM_ALPHA, Lists
from splat.raster.records import RecordLayout, Records
from splat.raster.tiles import LANES_ACROSS, GridNumbers

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt

# A block stops once every pixel transmits less: what lies behind changes them by this share at most.
MINIMUM_TRANSMITTANCE = 1e-4
# A pixel of the image buffer.
PIXEL = RecordLayout((4,), red=1, green=1, blue=1, opacity=1)
CHANNELS = 4
# log2 of the smallest alpha, less what rounding may make of it.
_UNSEEN = math.log2(MINIMUM_ALPHA) - 0.006
# What divisors are at least.
_TINY = 1e-37
# Floats of an image that a lane reads or writes at once: two pixels.
_CHUNK = 2 * CHANNELS
# Minimax polynomial of 2^f on -0.5..0.5, relative error 7.5e-8.
_EXP2 = (1.00000007, 0.69314697, 0.2402212, 0.05550713, 0.00967554, 0.00132765)
_ROUNDING = 12582912.0  # 1.5 * 2^23: adding it rounds a float to an integer in its low mantissa bits


class Blocks:
    """Lanes (M,) that own a block of pixels each, given by its tile and its number in that, row by row.

    Attributes:
        side, pixels: of a block in pixels, and their number.
        x, y, centre_x, centre_y: its first pixel, and the centre of that.
        first, last: range of each lane in the lists; `last` is exclusive.
    """

    def __init__(self, arrays: Arrays, lists: Lists, tile: UInt, number: UInt):
        Float = arrays.plain.Float
        self._arrays, self.number = arrays, number
        self.side = lists.grid.side // LANES_ACROSS
        self.pixels = self.side**2
        left, top = first_pixel(lists.grid, tile)
        self.x = left + self.number % LANES_ACROSS * self.side
        self.y = top + self.number // LANES_ACROSS * self.side
        self.centre_x, self.centre_y = Float(self.x) + 0.5, Float(self.y) + 0.5
        self.first, self.last = lists.of(arrays, tile)

    @staticmethod
    def of_tiles(arrays: Arrays, lists: Lists, count: int, tiles: UInt | None = None) -> Blocks:
        """A lane per block, the 16 of a tile side by side, of the first tiles, or of those given."""
        UInt = arrays.plain.UInt
        lane = dr.arange(UInt, count * LANES_ACROSS**2)
        tile = lane // LANES_ACROSS**2
        if tiles is not None:
            tile = dr.gather(UInt, tiles, tile)
        return Blocks(arrays, lists, tile, lane % LANES_ACROSS**2)

    def is_active(self, i: UInt, transmittance: Sequence[Float]) -> Bool:
        """Whether splats are left and any pixel of the block still transmits light."""
        return (i < self.last) & (reduce(dr.maximum, transmittance) > MINIMUM_TRANSMITTANCE)

    def log2_alphas(self, splat: SimpleNamespace) -> list[tuple[Float, Float, Float]]:
        """For each pixel, row by row, log2 of a splat's alpha, not yet clamped, and its u and v."""
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

    def chunks(self, width: UInt) -> list[tuple[UInt, int]]:
        """Pairs of the block's pixels: position in an image of that width, in pairs, and first pixel."""
        return [
            (((self.y + pixel // self.side) * width + self.x + pixel % self.side) // 2, pixel)
            for pixel in range(0, self.pixels, 2)
        ]

    def loaded(self, image: Float, width: UInt, channels: int) -> list[list[Float]]:
        """For each pixel of the block the first channels of a flat image of that width in pixels."""
        values: list[list[Float]] = []
        for target, _ in self.chunks(width):
            two = self._arrays.packet(image, _CHUNK, target)
            values += [[two[first + c] for c in range(channels)] for first in (0, CHANNELS)]
        return values


class Shown:
    """Which blocks of a tile show which splats of its list: about a third of them."""

    def __init__(self, arrays: Arrays, lists: Lists, records: Records):
        self._arrays = arrays
        self._words = _by_block(arrays, _shown_in(arrays, lists, records), lists)

    def following(self, i: UInt, last: UInt, number: UInt) -> UInt:
        """The first pair from `i` on that a block shows; `last`, the end of its list, or above if none is."""
        plain = self._arrays.plain

        def word(i: UInt) -> UInt:
            return dr.gather(plain.UInt, self._words, (i >> 5) * LANES_ACROSS**2 + number, i < last)

        def step(i: UInt, left: UInt) -> tuple[UInt, UInt]:
            following = (i | 31) + 1
            return following, word(following)

        is_empty = lambda i, left: (left == 0) & (i < last)  # noqa: E731
        i, left = dr.while_loop((plain.UInt(i), word(i) >> (i & 31)), is_empty, step, mode="symbolic")
        return i + dr.tzcnt(left)


def _by_block(arrays: Arrays, shown: UInt, lists: Lists) -> UInt:
    """From per pair a bit for each of 16 blocks, per 32 pairs and block a bit for each of the pairs."""
    plain = arrays.plain
    pairs, _ = lists.of(arrays, lists.grid.tiles)
    group = dr.arange(plain.UInt, -(-dr.width(shown) // 32))

    def step(k: UInt, words: list[UInt]) -> tuple[UInt, list[UInt]]:
        pair = group * 32 + k
        blocks = dr.gather(plain.UInt, shown, pair, pair < pairs)
        return k + 1, [word | (blocks >> number & 1) << k for number, word in enumerate(words)]

    state = (dr.zeros(plain.UInt, dr.width(group)), [plain.UInt(0) for _ in range(LANES_ACROSS**2)])
    is_left = lambda k, words: k < 32  # noqa: E731
    _, words = dr.while_loop(state, is_left, step, mode="symbolic")
    table = dr.empty(plain.UInt, dr.width(group) * LANES_ACROSS**2)
    for half in range(2):
        packet = plain.ArrayXu(words[8 * half : 8 * half + 8])
        dr.scatter(table, packet, group * 2 + half, mode=dr.ReduceMode.Permute)
    dr.eval(table)
    return table


def _shown_in(arrays: Arrays, lists: Lists, records: Records) -> UInt:
    """(P,) per pair one bit for each block of the tile: whether the splat may be visible there.

    The ellipse in which a splat is visible is cut into bands, one per row of blocks, from the first to the
    last row of pixel centres. A block shows the splat if it meets the part of the ellipse in its band.
    """
    Float, UInt, side = arrays.plain.Float, arrays.plain.UInt, lists.grid.side // LANES_ACROSS
    pair = dr.arange(UInt, lists.pairs)
    splat, (x, y) = records.at(pair), first_pixel(lists.grid, lists.tile)
    # Of the tile's first pixel centre from the splat's centre; across, in blocks.
    x, y = (Float(x) + 0.5 - splat.x) * (1 / side), Float(y) + 0.5 - splat.y
    level, v_squared = splat.constant - _UNSEEN, dr.square(splat.v_y)
    scale = dr.rcp(dr.maximum(splat.u_x, _TINY)) * (1 / side)
    lean = splat.u_y * scale
    # The ellipse reaches farthest to the left so far below the centre, to the right so far above it.
    norm = dr.maximum(dr.square(splat.u_y) + v_squared, _TINY)
    tip = splat.u_y / dr.maximum(splat.v_y, _TINY) * dr.sqrt(dr.maximum(level, 0) / norm)
    shown = UInt(0)
    for row in range(LANES_ACROSS):
        top, bottom = y + float(row * side), y + float(row * side + side - 1)
        nearest, at_left, at_right = (dr.clip(value, top, bottom) for value in (0, tip, -tip))
        half_left, half_right = (
            dr.sqrt(dr.maximum(dr.fma(-v_squared * dy, dy, level), 0)) * scale for dy in (at_left, at_right)
        )
        left, right = -half_left - lean * at_left - x, half_right - lean * at_right - x
        # The first block that ends behind the left tip, and the first that begins behind the right one.
        first = UInt(dr.ceil(dr.clip(left - (side - 1) / side, 0, LANES_ACROSS)))
        end = UInt(dr.clip(right + 1, 0, LANES_ACROSS))
        blocks = ((UInt(1) << end) - 1) & ~((UInt(1) << first) - 1)
        meets = v_squared * dr.square(nearest) <= level
        shown |= dr.select(meets, blocks << (LANES_ACROSS * row), 0)
    dr.eval(shown)
    return shown


def first_pixel(grid: GridNumbers, tile: UInt) -> tuple[UInt, UInt]:
    """Column and row of the first pixel of tiles."""
    row = tile // grid.columns
    return (tile - row * grid.columns) * grid.side, row * grid.side


def records_of_pairs(blended: Records, lists: Lists) -> Records:
    """The splats' numbers, one record per pair, in the order in which the tiles read them."""
    per_pair = blended.gathered(lists.splat)
    # With the ranges, which no kernel may have found yet.
    dr.eval(per_pair.tables, lists.ranges)
    return per_pair


def exp2(arrays: Arrays, power: Float) -> Float:
    """2^power for power <= 0; 2^-16, far under the smallest alpha, for any power below -16."""
    Float, Int = arrays.plain.Float, arrays.plain.Int
    clamped = dr.maximum(power, -16.0)
    shifted = clamped + _ROUNDING
    fraction = clamped - (shifted - _ROUNDING)
    value = dr.fma(fraction, _EXP2[5], _EXP2[4])
    for coefficient in _EXP2[3::-1]:
        value = dr.fma(fraction, value, coefficient)
    bits, exponent = (Int(dr.reinterpret_array(Int, number)) for number in (value, shifted))
    return Float(dr.reinterpret_array(Float, bits + (exponent << 23)))
