"""Composites layer images of one view, drawn at several sampling rates, into a frame by their weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from compose.base.frozen import Frozen
from compose.camera.camera import Camera
from splat.lod.layer_images import AtlasEntry, SplatImage
from splat.raster.blocks import CHANNELS, PIXEL
from splat.raster.records import RecordLayout, Records, records_before
from splat.raster.tiles import TILE, TileGrid

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

# A lane composites 4 x 4 pixels. At rates above 0 they lie between 4 x 4 samples at most.
_BLOCK = 4
_PER_CELL = (TILE // _BLOCK) ** 2
# Of an entry: samples per pixel, its first row in the atlas, and its last column and row. Nothing is spare.
_INTEGERS = "top", "last_x", "last_y"
_ENTRY = RecordLayout((4,), _INTEGERS, **dict.fromkeys(("scale", *_INTEGERS), 1))
# Entries whose bits make a word.
_WORD = 32
# Beyond it a weight of 0 would not hide a sample.
_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Mixture:
    """Which entries of an atlas the cells of a frame show, and with which weights, as kernels read it.

    What changes with the gaze is one array: the entries, per cell a bit for each entry that covers it, and
    the entries' weights at the corners of cells. The other numbers are of width 1.
    """

    cells: int  # how many there are, and words per cell
    words: int
    records: Records  # of the entries, and the rest behind them
    bits: UInt  # where the words of bits begin, and the weights
    weights: UInt
    columns: UInt  # of cells
    cell_count: UInt
    corner_count: UInt
    stride: UInt  # pixels per row of the atlas, and of the frame
    width: UInt

    @staticmethod
    def of(arrays: Arrays, entries: Sequence[AtlasEntry], stride: int, camera: Camera) -> Mixture:
        """The mixture of a camera's frame from an atlas of so many samples per row; at least one entry."""
        grid, rates = TileGrid(camera.width, camera.height), [entry.image.rate for entry in entries]
        rows = _ENTRY.rows(
            scale=[0.5**rate for rate in rates],
            top=[entry.top for entry in entries],
            last_x=[(camera.width - 1) >> rate for rate in rates],
            last_y=[(camera.height - 1) >> rate for rate in rates],
        )
        covered = np.stack([entry.cells.ravel() for entry in entries])
        words = [
            (np.uint32(1) << np.arange(len(some), dtype=np.uint32)) @ some
            for some in (covered[k : k + _WORD] for k in range(0, len(covered), _WORD))
        ]
        weights = np.stack([entry.image.weight for entry in entries])
        bits, cells = rows.size, covered.shape[1]
        parts = bits, bits + len(words) * cells
        sizes = grid.columns, cells, weights[0].size, stride, grid.padded_width
        records = records_before(arrays, _ENTRY, rows, np.stack(words).astype(np.uint32), weights)
        return Mixture(cells, len(words), records, *map(arrays.constant, (*parts, *sizes)))

    def weight(self, index: UInt) -> Float:
        """The number at an index of the array."""
        return dr.gather(self.records.arrays.plain.Float, self.records.tables[0], index)


def composite(arrays: Arrays, entries: Sequence[AtlasEntry], atlas: SplatImage, camera: Camera) -> SplatImage:
    """The frame, black in cells in which no entry has a weight; in all others, the weights must sum to 1.

    There is at least one entry.
    """
    radiance = _composited(arrays, Mixture.of(arrays, entries, atlas.stride, camera), atlas.values)
    padded = TileGrid(camera.width, camera.height).padded_width
    return SplatImage(arrays, radiance, camera.width, camera.height, padded, nodes=atlas.nodes)


def composited(arrays: Arrays, mixture: Mixture, atlas: Float, frame: Float | None = None) -> Float:
    """The pixels of a frame of whole tiles, three floats each, from those of an atlas, four floats each.

    If a `frame` of four floats each is given, it is changed but for cells that no entry covers.
    """
    plain = arrays.plain
    lane = dr.arange(plain.UInt, mixture.cells * _PER_CELL)
    cell = lane // _PER_CELL
    block = _Block(mixture, lane % _PER_CELL, cell)
    words = []
    for k in range(mixture.words):
        bits = mixture.weight(mixture.bits + mixture.cell_count * k + cell)
        words.append(plain.UInt(dr.reinterpret_array(plain.UInt, bits)))
    shown = plain.UInt(0)
    for word in words:
        shown += dr.popcnt(word)
    samples = Records(arrays, PIXEL, [atlas])
    # Built one by one: [Float(0)] * n would be a single accumulator n times.
    total = [plain.Float(0) for _ in range(3 * _BLOCK**2)]
    is_left = lambda word, total: word != 0  # noqa: E731
    for k, word in enumerate(words):

        def step(word: UInt, total: list[Float], first: int = k * _WORD) -> tuple[UInt, list[Float]]:
            number = dr.tzcnt(word) + first
            weights = [dr.select(shown > 1, weight, 1) for weight in block.weights(number)]
            pixels = block.interpolated(mixture.records.at(number), samples)
            added = [dr.fma(v, weights[i // 3], total[i]) for i, v in enumerate(pixels)]
            return word & (word - 1), added

        _, total = dr.while_loop((word, total), is_left, step, mode="symbolic")
    channels, known = (3, True) if frame is None else (CHANNELS, shown > 0)
    if frame is None:
        frame = dr.empty(plain.Float, mixture.cells * TILE**2 * channels)
    else:
        total = [v for p in range(_BLOCK**2) for v in (*total[3 * p : 3 * p + 3], plain.Float(1))]
    for chunk in range(len(total) // 4):
        pixel = (block.y + chunk // channels) * mixture.width + block.x
        target = pixel * channels // 4 + chunk % channels
        arrays.put_packet(frame, total[4 * chunk : 4 * chunk + 4], target, known)
    dr.eval(frame)
    return frame


_composited = Frozen(composited, by_size=True)


class _Block:
    """The lanes: one per block of pixels, those of a cell side by side; x, y is its first pixel."""

    def __init__(self, mixture: Mixture, number: UInt, cell: UInt):
        across = TILE // _BLOCK
        self._mixture, self._row = mixture, cell // mixture.columns
        self._column = cell - self._row * mixture.columns
        self._inner = number % across * _BLOCK, number // across * _BLOCK
        self.x, self.y = self._column * TILE + self._inner[0], self._row * TILE + self._inner[1]

    def weights(self, entry: UInt) -> list[Float]:
        """Weight of an entry in each pixel, from those at the corners of the cell."""
        mixture, Float = self._mixture, self._mixture.records.arrays.plain.Float
        first = mixture.weights + entry * mixture.corner_count
        above = first + self._row * (mixture.columns + 1) + self._column
        below = above + mixture.columns + 1
        corners = [mixture.weight(index) for index in (above, above + 1, below, below + 1)]
        left, top = (Float(inner) * (1 / TILE) for inner in self._inner)
        weights = []
        for row in range(_BLOCK):
            down = top + (row + 0.5) / TILE
            start, end = dr.lerp(corners[0], corners[2], down), dr.lerp(corners[1], corners[3], down)
            weights += [dr.lerp(start, end, left + (column + 0.5) / TILE) for column in range(_BLOCK)]
        return weights

    def interpolated(self, entry: SimpleNamespace, samples: Records) -> list[Float]:
        """Red, green, blue of each pixel of the block, linear between the samples of an entry.

        Beyond its outermost samples, pixels show those.
        """
        Int, UInt, Float = (getattr(samples.arrays.plain, kind) for kind in ("Int", "UInt", "Float"))
        bases, shares = [], []
        for first in (self.x, self.y):
            start = dr.fma(Float(first) + 0.5, entry.scale, -0.5)
            base = dr.floor(start)
            bases.append(Int(base))
            # Of each pixel the shares of four samples.
            at = [dr.fma(entry.scale, float(p), start - base) for p in range(_BLOCK)]
            shares.append([[dr.maximum(1 - dr.abs(u - float(i)), 0) for i in range(_BLOCK)] for u in at])
        last = Int(entry.last_x), Int(entry.last_y)
        columns, rows = (
            [UInt(dr.clip(b + i, 0, end)) for i in range(_BLOCK)] for b, end in zip(bases, last, strict=True)
        )
        down = [[Float(0) for _ in range(3 * _BLOCK)] for _ in range(_BLOCK)]
        for j, row in enumerate(rows):
            across = [Float(0) for _ in range(3 * _BLOCK)]
            for i, column in enumerate(columns):
                sample = samples.at((entry.top + row) * self._mixture.stride + column)
                for c, value in enumerate((sample.red, sample.green, sample.blue)):
                    value = dr.minimum(value, _LARGEST)
                    for p in range(_BLOCK):
                        across[3 * p + c] = dr.fma(value, shares[0][p][i], across[3 * p + c])
            for q in range(_BLOCK):
                down[q] = [dr.fma(v, shares[1][q][j], d) for v, d in zip(across, down[q], strict=True)]
        return [value for row in down for value in row]
