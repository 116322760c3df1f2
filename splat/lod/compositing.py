"""Composites layer images of one view, drawn at several sampling rates, into a frame by their weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from splat.lod.layer_images import AtlasEntry, Mask, SplatImage
from splat.raster.blocks import CHANNELS, PIXEL
from splat.raster.records import RecordLayout, Records, records_before
from splat.raster.tiles import TILE, TileGrid

# A lane composites 4 x 4 pixels: that is one sample at rate 2, four at rate 1.
_BLOCK = 4
_BLOCK_RATE = 2
_PER_CELL = (TILE // _BLOCK) ** 2
# Entries of the atlas by whose combinations cells are counted at once.
_ENTRIES_AT_ONCE = 8
# Weights at the corners of a cell. Nothing is spare.
_CORNERS = RecordLayout((4,), top_left=1, top_right=1, bottom_left=1, bottom_right=1)


def composite(
    arrays: Arrays,
    entries: Sequence[AtlasEntry],
    atlas: SplatImage,
    camera: Camera,
    frame: SplatImage | None = None,
) -> SplatImage:
    """The frame, black in cells in which no entry has a weight; in all others, the weights must sum to 1.

    There is at least one entry. Instead of being black, cells keep what they show in the rasterizer's
    `frame`, if that is given; it is changed.
    """
    Float, grid = arrays.plain.Float, TileGrid(camera.width, camera.height)
    covered = np.stack([entry.cells.ravel() for entry in entries])
    groups = _groups(covered, [entry.image.rate for entry in entries])
    if frame is None:
        channels = 3
        radiance = dr.empty(Float, grid.padded_width * grid.padded_height * channels)
    else:
        channels, radiance = frame.channels, frame.values
        groups = [group for group in groups if group.rates]
    sources = _Sources(arrays, entries, groups, atlas, camera)
    stride = arrays.constant(grid.padded_width)
    # Cells that need the same rates share their instructions, whichever entries those come from.
    for number, group in enumerate(groups):
        block, values = sources.mixed(number, group, arrays.constant(grid.columns))
        if channels == CHANNELS:
            values = [v for p in range(len(values) // 3) for v in (*values[3 * p : 3 * p + 3], Float(1))]
        for chunk in range(len(values) // 4):
            pixel = (block.y + chunk // channels) * stride + block.x
            part = arrays.plain.ArrayXf(values[4 * chunk : 4 * chunk + 4])
            target = pixel * channels // 4 + chunk % channels
            dr.scatter(radiance, part, target, mode=dr.ReduceMode.Permute)
    # Only now: scatters that are evaluated together become one kernel.
    dr.eval(radiance)
    shape = camera.width, camera.height, grid.padded_width, channels
    return SplatImage(arrays, radiance, *shape, nodes=atlas.nodes)


@dataclass(frozen=True)
class _Group:
    """Cells whose entries have the same rates."""

    rates: list[int]  # of their entries; empty for cells that no entry covers
    cells: NDArray[np.uint32]  # (M,) numbers of the cells
    entries: NDArray[np.uint32]  # (rates, M) the number of the entry, cell by cell


def _groups(covered: Mask, rates: Sequence[int]) -> list[_Group]:
    """Groups cells by the rates of the entries that cover them (entries, cells)."""
    combination, members = _combinations(covered)
    # For each combination of entries: which group it belongs to, and the entries' numbers in it.
    groups: dict[tuple[int, ...], int] = {}
    group_of = np.zeros(len(members), dtype=np.int64)
    number_of = np.zeros((len(covered), len(members)), dtype=np.uint32)
    for k, member in enumerate(members):
        numbers = np.flatnonzero(member).tolist()
        group_of[k] = groups.setdefault(tuple(rates[n] for n in numbers), len(groups))
        number_of[: len(numbers), k] = numbers
    group, found = group_of[combination], []
    for key, number in groups.items():
        cells = np.flatnonzero(group == number)
        entries = number_of[: len(key), combination[cells]]
        found.append(_Group(list(key), cells.astype(np.uint32), entries))
    return found


def _combinations(covered: Mask) -> tuple[NDArray[np.int64], Mask]:
    """Of a mask (entries, cells) the combination of entries in each cell (cells,), and those (C, entries)."""
    combination = np.zeros(covered.shape[1], dtype=np.int64)
    # Some entries at a time: a table of all combinations that many of them could have would not fit memory.
    for first in range(0, len(covered), _ENTRIES_AT_ONCE):
        some = covered[first : first + _ENTRIES_AT_ONCE]
        codes = (combination << len(some)) + (1 << np.arange(len(some))) @ some
        seen = np.bincount(codes) > 0
        combination = (np.cumsum(seen) - 1)[codes]
    cell = np.zeros(combination.max() + 1, dtype=np.int64)
    cell[combination] = np.arange(len(combination))
    return combination, covered[:, cell].T


class _Block:
    """The lanes: one per block of pixels, those of a cell side by side; x, y is its first pixel."""

    def __init__(self, lane: Any, cell: Any, columns: Any):
        block, across = lane % _PER_CELL, TILE // _BLOCK
        row = cell // columns
        self.x = (cell - row * columns) * TILE + block % across * _BLOCK
        self.y = row * TILE + block // across * _BLOCK


class _Sources:
    """The entries' samples and weights, and which of them each cell of each group shows.

    What changes with the gaze is one array: for each group its start, the groups' cells, and weights.
    """

    def __init__(
        self,
        arrays: Arrays,
        entries: Sequence[AtlasEntry],
        groups: Sequence[_Group],
        atlas: SplatImage,
        camera: Camera,
    ):
        self._arrays, self._stride = arrays, arrays.constant(atlas.stride)
        self._samples = Records(arrays, PIXEL, [atlas.values])
        self._size = arrays.constant(camera.width), arrays.constant(camera.height)
        tops = np.array([entry.top for entry in entries], dtype=np.uint32)
        weights = np.stack([entry.image.weight for entry in entries])
        above, below = weights[:, :-1], weights[:, 1:]
        corners = np.stack([above[..., :-1], above[..., 1:], below[..., :-1], below[..., 1:]], axis=-1)
        # Of each cell of a group its number, and for each rate which corners are its own and the first row.
        size = np.uint32(entries[0].cells.size)
        cells = [np.vstack([g.cells, g.entries * size + g.cells, tops[g.entries]]).T for g in groups]
        first = corners.size + np.cumsum([len(groups), *(part.size for part in cells)])[:-1]
        self._corners = records_before(arrays, _CORNERS, corners, first.astype(np.uint32), *cells)
        self._array = self._corners.tables[0]
        self._starts = arrays.constant(corners.size)

    def mixed(self, number: int, group: _Group, columns: Any) -> tuple[_Block, list[Any]]:
        """The blocks of a group, in a frame of so many columns of cells, and red, green, blue of pixels."""
        Float, UInt, count = self._arrays.plain.Float, self._arrays.plain.UInt, len(group.rates)
        at = lambda index: dr.reinterpret_array(UInt, dr.gather(Float, self._array, index))  # noqa: E731
        lane = dr.arange(UInt, len(group.cells) * _PER_CELL)
        cell = at(self._starts + self._arrays.constant(number)) + lane // _PER_CELL * (1 + 2 * count)
        block = _Block(lane, at(cell), columns)
        total = [Float(0) for _ in range(3 * _BLOCK * _BLOCK)]
        for k, rate in enumerate(group.rates):
            pixels = self._interpolated(block, rate, at(cell + (1 + count + k)))
            weights = [Float(1)] * len(pixels) if count == 1 else self._weight(block, at(cell + (1 + k)))
            for p, (pixel, weight) in enumerate(zip(pixels, weights, strict=True)):
                for c in range(3):
                    total[3 * p + c] = dr.fma(pixel[c], weight, total[3 * p + c])
        return block, total

    def _weight(self, block: _Block, corners: Any) -> list[Any]:
        """Weight in each pixel of a block, from those at the corners of its cell."""
        Float = self._arrays.plain.Float
        cell = self._corners.at(corners)
        left, top = Float(block.x % TILE) * (1 / TILE), Float(block.y % TILE) * (1 / TILE)
        weights = []
        for row in range(_BLOCK):
            down = top + (row + 0.5) / TILE
            start = dr.lerp(cell.top_left, cell.bottom_left, down)
            end = dr.lerp(cell.top_right, cell.bottom_right, down)
            weights += [dr.lerp(start, end, left + (column + 0.5) / TILE) for column in range(_BLOCK)]
        return weights

    def _interpolated(self, block: _Block, rate: int, top: Any) -> list[list[Any]]:
        """Red, green, blue of each pixel of a block, linear between samples of an entry from row `top` on."""
        Int, Float = self._arrays.plain.Int, self._arrays.plain.Float
        # Positions of a block's pixel centres in samples, if the block begins with a sample.
        positions = [(p + 0.5) / (1 << rate) - 0.5 for p in range(_BLOCK)]
        if rate <= _BLOCK_RATE:
            # It does, so that all blocks have the same offsets and weights.
            base_x, base_y = Int(block.x >> rate), Int(block.y >> rate)
            first, last = int(np.floor(positions[0])), int(np.ceil(positions[-1]))
            across = down = [(int(np.floor(p)), p - np.floor(p)) for p in positions]
        else:
            # A sample is larger than a block, which lies on one side of the sample's centre.
            start_x, start_y = (Float(v) * (1 / (1 << rate)) + positions[0] for v in (block.x, block.y))
            base_x, base_y = Int(dr.floor(start_x)), Int(dr.floor(start_y))
            first, last = 0, 1
            across, down = (
                [(0, start - Float(base) + (p - positions[0])) for p in positions]
                for start, base in ((start_x, base_x), (start_y, base_y))
            )
        offsets = range(first, last + 1)
        taps = {(j, i): self._tap(rate, top, base_x + i, base_y + j) for j in offsets for i in offsets}
        pixels = []
        for above, v in down:
            row = {i: _between(taps, (above, i), (above + 1, i), v) for i in offsets}
            pixels += [_between(row, left, left + 1, u) for left, u in across]
        return pixels

    def _tap(self, rate: int, top: Any, x: Any, y: Any) -> list[Any]:
        """Red, green, blue of a sample, or of the nearest one inside the frame."""
        Int, UInt = self._arrays.plain.Int, self._arrays.plain.UInt
        last_x, last_y = (Int((size + ((1 << rate) - 1)) >> rate) - 1 for size in self._size)
        index = (top + UInt(dr.clip(y, 0, last_y))) * self._stride + UInt(dr.clip(x, 0, last_x))
        sample = self._samples.at(index)
        return [sample.red, sample.green, sample.blue]


def _between(values: dict[Any, list[Any]], low: Any, high: Any, position: Any) -> list[Any]:
    """Three channels at a position, 0..1, between two keys."""
    if isinstance(position, float) and position == 0:
        return values[low]
    return [dr.lerp(a, b, position) for a, b in zip(values[low], values[high], strict=True)]
