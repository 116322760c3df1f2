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
from splat.lod.image import SplatImage
from splat.lod.layer_images import AtlasEntry, Mask
from splat.raster.blocks import CHANNELS, PIXEL
from splat.raster.records import RecordLayout, Records
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
    left_out: Mask | None = None,
) -> SplatImage:
    """The frame, black in cells in which no entry has a weight.

    Args:
        arrays: the backend's array types.
        entries: of the atlas, at least one; their weights sum to 1 in every cell in which any has one.
        atlas: the entries' samples.
        camera: the view.
        left_out: (rows, columns) cells that are not written and stay black: somebody else draws there, into a
            frame that has the rasterizer's channels.
    """
    Float, UInt, grid = arrays.plain.Float, arrays.plain.UInt, TileGrid(camera.width, camera.height)
    channels, new = (3, dr.empty) if left_out is None else (CHANNELS, dr.zeros)
    frame = new(arrays.plain.Float, grid.padded_width * grid.padded_height * channels)
    covered = np.stack([entry.cells.ravel() for entry in entries])
    sources = _Sources(arrays, entries, atlas, camera)
    stride = arrays.number(grid.padded_width)
    # Cells that need the same rates share their instructions, whichever entries those come from.
    for group in _groups(covered, [entry.image.rate for entry in entries], left_out):
        if left_out is not None and not group.rates:
            continue  # is black already
        block = _Block(arrays, UInt(group.cells), arrays.number(grid.columns))
        values = sources.mixed(block, group.rates, [UInt(numbers) for numbers in group.entries])
        if channels == CHANNELS:
            values = [v for p in range(len(values) // 3) for v in (*values[3 * p : 3 * p + 3], Float(1))]
        for chunk in range(len(values) // 4):
            pixel = (block.y + chunk // channels) * stride + block.x
            part = arrays.plain.ArrayXf(values[4 * chunk : 4 * chunk + 4])
            target = pixel * channels // 4 + chunk % channels
            dr.scatter(frame, part, target, mode=dr.ReduceMode.Permute)
    # Only now: scatters that are evaluated together become one kernel.
    dr.eval(frame)
    return SplatImage(frame, camera.width, camera.height, grid.padded_width, channels, atlas.nodes)


@dataclass(frozen=True)
class _Group:
    """Cells whose entries have the same rates.

    Attributes:
        rates: of their entries; empty for cells that no entry covers.
        cells: (M,) numbers of the cells.
        entries: for each of the rates (M,), the number of the entry, cell by cell.
    """

    rates: list[int]
    cells: NDArray[np.uint32]
    entries: list[NDArray[np.uint32]]


def _groups(covered: Mask, rates: Sequence[int], left_out: Mask | None) -> list[_Group]:
    """Groups cells by the rates of the entries that cover them.

    Args:
        covered: (entries, cells) bool.
        rates: of the entries.
        left_out: (rows, columns) cells that belong to no group.
    """
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
    if left_out is not None:
        group[left_out.ravel()] = -1
    for key, number in groups.items():
        cells = np.flatnonzero(group == number)
        if not len(cells):
            continue
        entries = [row[combination[cells]] for row in number_of[: len(key)]]
        found.append(_Group(list(key), cells.astype(np.uint32), entries))
    return found


def _combinations(covered: Mask) -> tuple[NDArray[np.int64], Mask]:
    """The combination of entries that covers each cell (cells,), and those combinations (C, entries).

    Args:
        covered: (entries, cells) bool.
    """
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
    """The lanes: one per block of pixels, those of a cell side by side.

    Attributes:
        entry: position of each lane's cell among the given ones.
        cell: its number in the frame.
        row: its row of cells.
        x, y: the block's first pixel.
    """

    def __init__(self, arrays: Arrays, cells: Any, columns: Any):
        UInt = arrays.plain.UInt
        lane = dr.arange(UInt, dr.width(cells) * _PER_CELL)
        self.entry = lane // _PER_CELL
        self.cell = dr.gather(UInt, cells, self.entry)
        block, across = lane % _PER_CELL, TILE // _BLOCK
        self.row = self.cell // columns
        self.x = (self.cell - self.row * columns) * TILE + block % across * _BLOCK
        self.y = self.row * TILE + block // across * _BLOCK


class _Sources:
    """The entries' samples and weights."""

    def __init__(self, arrays: Arrays, entries: Sequence[AtlasEntry], atlas: SplatImage, camera: Camera):
        self.arrays, self._stride = arrays, arrays.number(atlas.stride)
        self._samples = Records(arrays, PIXEL, [atlas.radiance])
        self._size = arrays.number(camera.width), arrays.number(camera.height)
        self._tops = arrays.plain.UInt(np.array([entry.top for entry in entries], dtype=np.uint32))
        weights = np.stack([entry.image.weight for entry in entries])
        self._weights = _CORNERS.upload(
            arrays,
            top_left=weights[:, :-1, :-1].ravel(),
            top_right=weights[:, :-1, 1:].ravel(),
            bottom_left=weights[:, 1:, :-1].ravel(),
            bottom_right=weights[:, 1:, 1:].ravel(),
        )
        self._cells = arrays.number(entries[0].cells.size)

    def mixed(self, block: _Block, rates: Sequence[int], entries: Sequence[Any]) -> list[Any]:
        """Red, green, blue of each pixel of a block.

        Args:
            block: the pixels.
            rates: of the entries that are mixed.
            entries: for each of the rates the number of the entry, by cell.
        """
        Float = self.arrays.plain.Float
        total = [Float(0) for _ in range(3 * _BLOCK * _BLOCK)]
        for rate, numbers in zip(rates, entries, strict=True):
            entry = dr.gather(self.arrays.plain.UInt, numbers, block.entry)
            pixels = self._interpolated(block, rate, dr.gather(self.arrays.plain.UInt, self._tops, entry))
            weights = self._weight(block, entry) if len(rates) > 1 else [Float(1)] * len(pixels)
            for number, (pixel, weight) in enumerate(zip(pixels, weights, strict=True)):
                for c in range(3):
                    total[3 * number + c] = dr.fma(pixel[c], weight, total[3 * number + c])
        return total

    def _weight(self, block: _Block, entry: Any) -> list[Any]:
        """Weight of an entry in each pixel of a block."""
        Float = self.arrays.plain.Float
        cell = self._weights.at(entry * self._cells + block.cell)
        left, top = Float(block.x % TILE) * (1 / TILE), Float(block.y % TILE) * (1 / TILE)
        weights = []
        for row in range(_BLOCK):
            down = top + (row + 0.5) / TILE
            start = dr.lerp(cell.top_left, cell.bottom_left, down)
            end = dr.lerp(cell.top_right, cell.bottom_right, down)
            weights += [dr.lerp(start, end, left + (column + 0.5) / TILE) for column in range(_BLOCK)]
        return weights

    def _interpolated(self, block: _Block, rate: int, top: Any) -> list[list[Any]]:
        """Red, green, blue of each pixel of a block, linear between the samples around it.

        Args:
            block: the pixels.
            rate: of the entry.
            top: its first row in the atlas.
        """
        Int, Float = self.arrays.plain.Int, self.arrays.plain.Float
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
        Int, UInt = self.arrays.plain.Int, self.arrays.plain.UInt
        last_x, last_y = (Int((size + ((1 << rate) - 1)) >> rate) - 1 for size in self._size)
        index = (top + UInt(dr.clip(y, 0, last_y))) * self._stride + UInt(dr.clip(x, 0, last_x))
        sample = self._samples.at(index)
        return [sample.red, sample.green, sample.blue]


def _between(values: dict[Any, list[Any]], low: Any, high: Any, position: Any) -> list[Any]:
    """Three channels at a position, 0..1, between two keys."""
    if isinstance(position, float) and position == 0:
        return values[low]
    return [dr.lerp(a, b, position) for a, b in zip(values[low], values[high], strict=True)]
