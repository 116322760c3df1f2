"""Blends binned splats front to back, tile by tile, and finds the gradient of that.

One lane owns a block of pixels, 4 x 4 in tiles of 16, whose transmittance and colour are loop variables:
each splat fetched from memory serves 16 pixels. Splat m contributes to a pixel
(Fov-GS Eq. 1 without its normalization): c_m = alpha_m prod_{n<m} (1 - alpha_n),
alpha_m = min(0.99, opacity exp(-d^T Sigma'^-1 d / 2)), or 0 where that is below 1/255.

A block stops once all of its pixels transmit less than 1e-4: what lies behind could change them by less
than 1e-4 of its radiance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from compose.base.frozen import Frozen
from splat.raster.binning import LOG2_E, MINIMUM_ALPHA, Bins, Lists
from splat.raster.blocks import CHANNELS, MINIMUM_TRANSMITTANCE, Blocks, Shown, exp2, records_of_pairs
from splat.raster.projection import Splats
from splat.raster.records import RecordLayout, Records
from splat.raster.tiles import LANES_ACROSS, TileGrid

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt

MAXIMUM_ALPHA = 0.99


@dataclass(frozen=True)
class Compositing:
    """How splats are composited, and which derivatives are wanted; part of a recording."""

    highest_alpha: float = MAXIMUM_ALPHA  # what alphas are cut to
    # Whether a pixel ends in front of the splat behind which it would transmit 1e-4 or less (Kerbl et al.).
    ends_pixels: bool = False
    by_opacity: bool = False  # whether the derivative of the loss by the opacity is given, too
    absolute: bool = False  # whether absolute values of the pixels' derivatives by x and y are summed, too


STANDARD = Compositing()
# Finding which blocks show a pair costs 1/40 of blending it. It does not pay where tiles have more pairs than
# this on average: blocks stop long before the end.
_LONG_LIST = 256


def rasterize(
    arrays: Arrays,
    blended: Records,
    bins: Bins,
    split: ImageSplit,
    images: list[Float] | None = None,
    rules: Compositing = STANDARD,
) -> list[Float]:
    """Renders linear radiance and opacity of the wanted tiles, from splats without derivatives; others are 0.

    The tiles are drawn into images, flat: padded height x padded width x 4, rows from the top; or new ones.
    """
    size = bins.lists.pairs
    if not size:
        return images or split.new(arrays, dr.zeros)
    jumping = jumps(arrays, size, int(np.count_nonzero(bins.wanted)))
    if images is not None:
        return blend(arrays, blended, bins.lists, split, jumping, images, bins.tiles, rules)
    return _blend(arrays, blended, bins.lists, split, jumping, None, None, rules)


def stays_together(arrays: Arrays) -> bool:
    """Whether lanes do not go by themselves, one from splat to splat that its block shows, as on a CPU."""
    return arrays.backend != "llvm"


def jumps(arrays: Arrays, pairs: int, tiles: int) -> bool:
    """Whether lanes jump over what they do not show where so many tiles blend so many pairs."""
    return not stays_together(arrays) and pairs <= _LONG_LIST * tiles


@dataclass(frozen=True)
class ImageSplit:
    """Images that lie one above the other in a grid of tiles."""

    heights: list[int]  # rows of tiles of each
    columns: int  # of tiles
    rows: list[UInt]  # of width 1: first row of pixels of each, and of what would follow
    side: int  # of a tile in pixels

    @staticmethod
    def of(arrays: Arrays, grid: TileGrid, heights: Sequence[int]) -> ImageSplit:
        """Images of so many rows of a grid's tiles."""
        above = np.cumsum([0, *heights]) * grid.side
        rows = [arrays.constant(row) for row in above.tolist()]
        return ImageSplit(list(heights), grid.columns, rows, grid.side)

    def new(self, arrays: Arrays, make: Callable[..., Float]) -> list[Float]:
        """New images, made by `dr.zeros` or `dr.empty`."""
        row = self.columns * self.side**2 * CHANNELS
        return [make(arrays.plain.Float, height * row) for height in self.heights]


def blend(
    arrays: Arrays,
    blended: Records,
    lists: Lists,
    split: ImageSplit,
    jumping: bool,
    images: list[Float] | None = None,
    tiles: UInt | None = None,
    rules: Compositing = STANDARD,
) -> list[Float]:
    """Draws the lists of all tiles into new images, or those of some tiles into given ones.

    `jumping` says whether lanes jump over what they do not show.
    """
    plain = arrays.plain
    if images is None:
        # They need not be cleared: every tile has lanes, which leave it black where nothing is drawn.
        images = split.new(arrays, dr.empty)
    count = sum(split.heights) * split.columns if tiles is None else dr.width(tiles)
    records = records_of_pairs(blended, lists)
    block = Blocks.of_tiles(arrays, lists, count, tiles)
    shown = Shown(arrays, lists, records) if jumping else None

    def following(i: UInt) -> UInt:
        return i if shown is None else shown.following(i, block.last, block.number)

    def step(
        i: UInt, transmittance: list[Float], colour: list[Float]
    ) -> tuple[UInt, list[Float], list[Float]]:
        splat = records.at(i)
        radiance = splat.red, splat.green, splat.blue
        transmittance, colour = list(transmittance), list(colour)
        for pixel, (power, _, _) in enumerate(block.log2_alphas(splat)):
            alpha = dr.minimum(exp2(arrays, power), rules.highest_alpha)
            alpha = dr.select(alpha >= MINIMUM_ALPHA, alpha, 0)
            weight, transmittance[pixel], _ = _composited(rules, alpha, transmittance[pixel])
            for c in range(3):
                colour[3 * pixel + c] = dr.fma(weight, radiance[c], colour[3 * pixel + c])
        return following(i + 1), transmittance, colour

    # Built one by one: [Float(0)] * n would be a single accumulator n times.
    light = [plain.Float(1) for _ in range(block.pixels)]
    black = [plain.Float(0) for _ in range(3 * block.pixels)]
    is_active = lambda i, transmittance, colour: block.is_active(i, transmittance)  # noqa: E731
    state = (following(block.first), light, black)
    _, transmittance, colour = dr.while_loop(state, is_active, step, mode="symbolic")
    left = [dr.abs(value) for value in transmittance] if rules.ends_pixels else transmittance
    pixels = [[*colour[3 * p : 3 * p + 3], 1 - left[p]] for p in range(block.pixels)]
    rows, width = split.rows, lists.grid.width
    within: list[Bool | bool] = [True]
    if len(images) > 1:
        within = [(block.y >= top) & (block.y < bottom) for top, bottom in pairwise(rows)]
    for target, first in block.chunks(width):
        values = [*pixels[first], *pixels[first + 1]]
        for image, own, row in zip(images, within, rows[:-1], strict=True):
            arrays.put_packet(image, values, target - row * width // 2, own)
    dr.eval(images)
    return images


_blend = Frozen(blend, by_size=True)


def _composited(rules: Compositing, alpha: Float, transmittance: Float) -> tuple[Float, Float, Bool | bool]:
    """Weight of a splat in pixels, their transmittance behind it, and whether it counts.

    `transmittance` is that in front of it. Where a pixel has ended, it is negative: its absolute value stays
    what it was, and nothing counts any more.
    """
    weight = alpha * transmittance
    behind = transmittance - weight
    if not rules.ends_pixels:
        return weight, behind, True
    counts = behind > MINIMUM_TRANSMITTANCE
    return dr.select(counts, weight, 0), dr.select(counts, behind, -dr.abs(transmittance)), counts


# Sums per pair: those of `_block_sums`. In packets, to which the lanes of a vector add one after the other;
# or each by itself, with atomic additions.
_SUMS, _ABSOLUTE = 9, 2
_IN_PACKETS, _ONE_BY_ONE = RecordLayout((8, 2), sums=_SUMS), RecordLayout((8, 1), sums=_SUMS)
_WITH_ABSOLUTE = RecordLayout((8, 4), sums=_SUMS + _ABSOLUTE)


def no_sums(arrays: Arrays, splats: int, rules: Compositing = STANDARD) -> list[Float]:
    """What `sums_of_bins` adds to first, of so many splats."""
    return [dr.zeros(arrays.plain.Float, splats) for _ in range(_SUMS + _ABSOLUTE * rules.absolute)]


def sums_of_bins(
    arrays: Arrays,
    blended: Records,
    bins: Bins,
    image: Float,
    gradient: Float,
    sums: list[Float] | None = None,
    rules: Compositing = STANDARD,
) -> list[Float]:
    """What the lists of some tiles contribute to the sums that each splat's gradient is made of.

    Args:
        blended, bins, image, rules: as given to and returned by `rasterize`.
        gradient: of the loss by the image; that by the opacity counts only if the rules say so.
        sums: those over tiles further up, and to the left in the same row, to which they are added.
    """
    if not bins.lists.pairs:
        return sums or no_sums(arrays, len(blended), rules)
    runs, alone = (bins.first, bins.count, bins.owner), not stays_together(arrays)
    walked = WalkedLists(blended, bins.lists, bins.tiles, *runs, alone, rules)
    return _sums(arrays, walked, image, gradient, sums)


@dataclass(frozen=True)
class WalkedLists:
    """The lists of some tiles, and the splats in them, as a recording takes them."""

    blended: Records
    lists: Lists
    tiles: UInt  # (T,) numbers of the tiles
    first: UInt  # first, count, owner: as in `Bins`
    count: UInt
    owner: UInt
    alone: bool  # whether lanes go by themselves
    rules: Compositing


def sums_of_lists(
    arrays: Arrays, walked: WalkedLists, image: Float, gradient: Float, sums: list[Float] | None = None
) -> list[Float]:
    """Nine (N,) sums, or eleven, over the lists of some tiles, added to earlier ones if there are any.

    Walks each list front to back once more. With T_m the transmittance in front of splat m, c_m its colour
    and S the light that arrives from behind it, which is the final colour less all that was added up to m:
    d colour / d alpha_m = T_m c_m - S / (1 - alpha_m).

    S is exact to some 1e-7 of the final colour. Behind a splat that is a million times brighter than all
    that lies behind it, gradients are noise of that size.
    """
    lists, alone = walked.lists, walked.alone
    UInt = arrays.plain.UInt
    records = records_of_pairs(walked.blended, lists)
    shown = Shown(arrays, lists, records) if alone else None
    walk = _Walk(arrays, lists, records, image, gradient, shown, walked.rules)
    slots = [dr.zeros(arrays.plain.Float, p.size * lists.pairs) for p in walk.layout.packets]
    if alone:
        # A vector has four lanes or more and so all those of a tile: two threads never add to a pair.
        lane = dr.arange(UInt, dr.width(walked.tiles) * LANES_ACROSS)
        tile, column = dr.gather(UInt, walked.tiles, lane // LANES_ACROSS), lane % LANES_ACROSS
        is_left = lambda row, slots: row < LANES_ACROSS  # noqa: E731
        step = lambda row, slots: (row + 1, walk.added(tile, row * LANES_ACROSS + column, slots))  # noqa: E731
        _, slots = dr.while_loop((dr.zeros(UInt, dr.width(lane)), slots), is_left, step, mode="symbolic")
    else:
        lane = dr.arange(UInt, dr.width(walked.tiles) * LANES_ACROSS**2)
        tile = dr.gather(UInt, walked.tiles, lane // LANES_ACROSS**2)
        slots = walk.added(tile, lane % LANES_ACROSS**2, slots)
    dr.eval(slots)
    earlier = sums or no_sums(arrays, len(walked.blended), walked.rules)
    return _sum_runs(arrays, walked, Records(arrays, walk.layout, slots), earlier)


_sums = Frozen(sums_of_lists, by_size=True)


@dataclass(frozen=True)
class _Walk:
    arrays: Arrays  # this, lists, image, gradient: as for `sums_of_lists`
    lists: Lists
    records: Records  # the splats, per pair
    image: Float
    gradient: Float
    # Which blocks show which pairs, if lanes go by themselves and add in packets; None if they stay together.
    shown: Shown | None
    rules: Compositing

    @property
    def layout(self) -> RecordLayout:
        if self.rules.absolute:
            return _WITH_ABSOLUTE
        return _ONE_BY_ONE if self.shown is None else _IN_PACKETS

    def added(self, tile: UInt, number: UInt, slots: list[Float]) -> list[Float]:
        """Adds what the blocks with a number in tiles contribute to the sums of pairs."""
        arrays, lists = self.arrays, self.lists
        plain = arrays.plain
        block, width = Blocks(arrays, lists, tile, number), lists.grid.width
        channels = CHANNELS if self.rules.by_opacity else CHANNELS - 1
        flow, final = (block.loaded(image, width, channels) for image in (self.gradient, self.image))
        behind = [sum(f * v for f, v in zip(flow[p], final[p], strict=True)) for p in range(block.pixels)]

        def step(
            i: UInt, transmittance: list[Float], behind: list[Float], slots: list[Float]
        ) -> tuple[UInt, list[Float], list[Float], list[Float]]:
            transmittance, behind = list(transmittance), list(behind)
            sums = _block_sums(arrays, block, self.records.at(i), flow, transmittance, behind, self.rules)
            sums += [plain.Float(0) for _ in range(self.layout.spare)]
            pair = dr.gather(plain.UInt, lists.unsorted, i)
            for packet, slot in zip(self.layout.packets, slots, strict=True):
                values = arrays.plain.ArrayXf(sums[packet.floats])
                dr.scatter_reduce(dr.ReduceOp.Add, slot, values, pair, mode=mode)
            return following(i + 1), transmittance, behind, slots

        def following(i: UInt) -> UInt:
            return i if self.shown is None else self.shown.following(i, block.last, number)

        # Packets are read, added to and written lane by lane, also where lanes have the same pair.
        mode = dr.ReduceMode.Local if self.shown is None else dr.ReduceMode.NoConflicts
        state = (following(block.first), [plain.Float(1) for _ in range(block.pixels)], behind, slots)
        is_active = lambda i, transmittance, behind, slots: block.is_active(i, transmittance)  # noqa: E731
        *_, slots = dr.while_loop(state, is_active, step, mode="symbolic")
        return slots


def _block_sums(
    arrays: Arrays,
    block: Blocks,
    splat: SimpleNamespace,
    flow: list[list[Float]],
    transmittance: list[Float],
    behind: list[Float],
    rules: Compositing,
) -> list[Float]:
    """Sums over a block's pixels for one splat, and the step past that splat.

    They are of dL/dpower times 1, u, v, u^2, u v, v^2, where power = ln alpha and u and v are those of
    `Blocks.log2_alphas`, of dL/dcolour times the weight of the pixel, three channels, and, if wanted, of
    |dL/dx| and |dL/dy|, x and y the splat's centre.

    Args:
        flow: derivatives of the loss by each pixel's channels.
        transmittance: per pixel in front of the splat; on return, behind it.
        behind: per pixel the light from the splat and from behind it, weighted by `flow`; on return, only
            that from behind it.
    """
    # What is opaque adds to opacity as what shines to radiance.
    radiance = [splat.red, splat.green, splat.blue, 1][: len(flow[0])]
    sizes = 6, 3, _ABSOLUTE * rules.absolute
    moments, colours, absolute = ([arrays.plain.Float(0) for _ in range(size)] for size in sizes)
    for pixel, (power, u, v) in enumerate(block.log2_alphas(splat)):
        unclamped = exp2(arrays, power)
        alpha = dr.minimum(unclamped, rules.highest_alpha)
        seen = alpha >= MINIMUM_ALPHA
        alpha = dr.select(seen, alpha, 0)
        weight, left, counts = _composited(rules, alpha, transmittance[pixel])
        here = flow[pixel]
        own = sum(f * r for f, r in zip(here, radiance, strict=True))
        behind[pixel] = dr.fma(-weight, own, behind[pixel])
        by_alpha = dr.fma(transmittance[pixel], own, -behind[pixel] * dr.rcp(1 - alpha))
        by_power = dr.select(seen & counts & (unclamped < rules.highest_alpha), by_alpha * alpha, 0)
        transmittance[pixel] = left
        along_u, along_v = by_power * u, by_power * v
        for k, term in enumerate((by_power, along_u, along_v)):
            moments[k] = moments[k] + term
        for k, (along, by) in enumerate(((along_u, u), (along_u, v), (along_v, v)), 3):
            moments[k] = dr.fma(along, by, moments[k])
        for c in range(3):
            colours[c] = dr.fma(weight, here[c], colours[c])
        if rules.absolute:
            along_y = dr.fma(splat.u_y, along_u, splat.v_y * along_v)
            for k, along in enumerate((splat.u_x * along_u, along_y)):
                absolute[k] = dr.fma(dr.abs(along), 2 / LOG2_E, absolute[k])
    return moments + colours + absolute


def _sum_runs(arrays: Arrays, walked: WalkedLists, slots: Records, sums: list[Float]) -> list[Float]:
    """(N,) sums over each splat's pairs, added to earlier ones always in the same order."""
    plain = arrays.plain

    def add(i: UInt, sums: list[Float]) -> tuple[UInt, list[Float]]:
        return i + 1, [s + further for s, further in zip(sums, slots.at(i).sums, strict=True)]

    end = walked.first + walked.count
    state = (plain.UInt(walked.first), [dr.gather(plain.Float, values, walked.owner) for values in sums])
    is_left = lambda i, sums: i < end  # noqa: E731
    _, added = dr.while_loop(state, is_left, add, mode="symbolic")
    dr.eval(added)
    totals = []
    for values, earlier in zip(added, sums, strict=True):
        total = plain.Float(earlier)
        dr.scatter(total, values, walked.owner, mode=dr.ReduceMode.Permute)
        totals.append(total)
    dr.eval(totals)
    return totals


def gradients_from_sums(splats: Splats, sums: list[Float]) -> list[Float]:
    """Gradients by the splats' parameters from the sums over all tiles, in the order of `_block_sums`.

    power = ln opacity - (x_precision t^2 + y_precision dy^2) / 2 with t = dx + shear dy, and u^2 and v^2 are
    those squares times log2(e) / 2.
    """
    s, su, sv, suu, suv, svv, *colour = sums
    to_x, to_y = (dr.sqrt((2 / LOG2_E) * value) for value in (splats.x_precision, splats.y_precision))
    by_x = to_x * su
    return [
        by_x,
        dr.fma(splats.shear, by_x, to_y * sv),
        suu * dr.rcp(-LOG2_E * splats.x_precision),
        -to_x * suv * dr.rsqrt((0.5 * LOG2_E) * splats.y_precision),
        svv * dr.rcp(-LOG2_E * splats.y_precision),
        dr.select(splats.opacity > 0, s * dr.rcp(dr.maximum(splats.opacity, 1e-12)), 0),
        *colour,
    ]
