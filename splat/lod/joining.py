"""Joins pictures of one view, drawn at several sampling rates, into one frame: pixel by pixel, by shares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from splat.base.arrays import Arrays
from splat.raster.binning import TILE
from splat.raster.blocks import CHANNELS

Lattice = NDArray[np.float32]
Mask = NDArray[np.bool_]
# A lane joins 4 x 4 pixels: that is one sample at rate 2, four at rate 1.
_BLOCK = 4
_BLOCK_RATE = 2
_PER_CELL = (TILE // _BLOCK) ** 2


@dataclass(frozen=True)
class Picture:
    """One layer at one rate.

    Attributes:
        layer: 1, the coarsest, to L.
        rate: log2 of pixels per sample along each axis, 0 for every pixel.
        share: (rows + 1, columns + 1) share in the frame, 0..1, at the corners of cells of TILE pixels.
    """

    layer: int
    rate: int
    share: Lattice


@dataclass(frozen=True)
class Panel:
    """A picture's place in the image that holds all of them.

    Attributes:
        picture: what it shows.
        top: first row of samples in that image.
        tiles: (rows, columns) bool, its tiles that are drawn.
        cells: (rows, columns) bool, the cells of TILE pixels of the frame in which it has a share.
    """

    picture: Picture
    top: int
    tiles: Mask
    cells: Mask


def lay_out(pictures: Sequence[Picture], wanted: Mask, tile: int) -> list[Panel]:
    """Places for the pictures that have a share in what is wanted, one below the other.

    Args:
        pictures: what is joined.
        wanted: (rows, columns) bool, cells that are drawn at all.
        tile: side of the rasterizer's tiles, in samples.
    """
    panels, top = [], 0
    for picture in pictures:
        cells = cells_of(picture.share) & wanted
        if cells.any():
            # A pixel at the border of a cell looks up samples beyond it.
            tiles = _resized(_grown(cells) if picture.rate else cells, TILE, tile << picture.rate)
            panels.append(Panel(picture, top, tiles, cells))
            top += tiles.shape[0] * tile
    return panels


def cells_of(share: Lattice) -> Mask:
    """(rows, columns) the cells in which a picture of that share at their corners is seen."""
    return np.maximum.reduce([share[:-1, :-1], share[1:, :-1], share[:-1, 1:], share[1:, 1:]]) > 0


def join(
    arrays: Arrays, panels: Sequence[Panel], image: Any, image_width: int, width: int, height: int
) -> Any:
    """Flat buffer of (height, width, 3), both rounded up to whole cells; black where no panel has a share.

    Args:
        arrays: the backend's array types.
        panels: by their shares, that sum to 1 in every cell in which any has one.
        image: the panels' samples, flat.
        image_width: in samples.
        width, height: of the frame in pixels.
    """
    UInt = arrays.plain.UInt
    rows, columns = -(-height // TILE), -(-width // TILE)
    frame = dr.empty(arrays.plain.Float, rows * columns * TILE * TILE * 3)
    which = np.stack([panel.cells.ravel() for panel in panels])
    sources = _Sources(arrays, panels, image, image_width, width, height)
    stride = arrays.number(columns * TILE)
    # Cells that need the same rates share their instructions, whichever panels those come from.
    for rates, cells, chosen in _by_rates(which, [panel.picture.rate for panel in panels]):
        block = _Block(arrays, UInt(cells), arrays.number(columns))
        values = sources.mixed(block, rates, [UInt(numbers) for numbers in chosen])
        for chunk in range(len(values) // 4):
            place = (block.y + chunk // 3) * stride + block.x
            part = arrays.plain.ArrayXf(values[4 * chunk : 4 * chunk + 4])
            dr.scatter(frame, part, place * 3 // 4 + chunk % 3, mode=dr.ReduceMode.Permute)
    # Only now: scatters that are evaluated together become one kernel.
    dr.eval(frame)
    return frame


def _by_rates(
    which: Mask, rates: Sequence[int]
) -> list[tuple[list[int], NDArray[np.uint32], list[NDArray[np.uint32]]]]:
    """Cells grouped by the rates of their panels, none among them.

    Returns:
        Rates, cells, and for each of the rates, cell by cell, the number of the panel.
    """
    codes = (1 << np.arange(len(which))) @ which
    # Of each combination of panels: which group of rates it belongs to, and the panels' numbers in it.
    groups: dict[tuple[int, ...], int] = {}
    group_of = np.zeros(1 << len(which), dtype=np.int64)
    number_of = np.zeros((len(which), 1 << len(which)), dtype=np.uint32)
    for code in np.flatnonzero(np.bincount(codes)):
        numbers = [n for n in range(len(which)) if code >> n & 1]
        group_of[code] = groups.setdefault(tuple(rates[n] for n in numbers), len(groups))
        number_of[: len(numbers), code] = numbers
    group, found = group_of[codes], []
    for key, number in groups.items():
        cells = np.flatnonzero(group == number)
        of_cells = codes[cells]
        found.append((list(key), cells.astype(np.uint32), [row[of_cells] for row in number_of[: len(key)]]))
    return found


class _Block:
    """The lanes: one per block of pixels, those of a cell side by side.

    Attributes:
        entry: which of the given cells.
        cell: its number in the frame.
        row: of cells.
        x, y: first pixel.
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
    """The panels' samples and shares."""

    def __init__(
        self, arrays: Arrays, panels: Sequence[Panel], image: Any, image_width: int, width: int, height: int
    ):
        self.arrays, self._image, self._image_width = arrays, image, arrays.number(image_width)
        self._size = arrays.number(width), arrays.number(height)
        self._tops = arrays.plain.UInt(np.array([panel.top for panel in panels], dtype=np.uint32))
        self._shares = arrays.plain.Float(_cell_corners(panels))
        self._cells = arrays.number(panels[0].cells.size)

    def mixed(self, block: _Block, rates: Sequence[int], panels: Sequence[Any]) -> list[Any]:
        """Three channels of each pixel of a block.

        Args:
            block: the pixels.
            rates: of the pictures that are mixed.
            panels: for each of them, the number of its panel, by cell.
        """
        Float = self.arrays.plain.Float
        total = [Float(0) for _ in range(3 * _BLOCK * _BLOCK)]
        for rate, numbers in zip(rates, panels, strict=True):
            panel = dr.gather(self.arrays.plain.UInt, numbers, block.entry)
            pixels = self._interpolated(block, rate, dr.gather(self.arrays.plain.UInt, self._tops, panel))
            shares = self._share(block, panel) if len(rates) > 1 else [Float(1)] * len(pixels)
            for number, (pixel, share) in enumerate(zip(pixels, shares, strict=True)):
                for c in range(3):
                    total[3 * number + c] = dr.fma(pixel[c], share, total[3 * number + c])
        return total

    def _share(self, block: _Block, panel: Any) -> list[Any]:
        """Share of a panel in each pixel of a block."""
        Float = self.arrays.plain.Float
        corners = self.arrays.record(self._shares, panel * self._cells + block.cell, 4)
        left, top = Float(block.x % TILE) * (1 / TILE), Float(block.y % TILE) * (1 / TILE)
        shares = []
        for row in range(_BLOCK):
            down = top + (row + 0.5) / TILE
            start, end = dr.lerp(corners[0], corners[2], down), dr.lerp(corners[1], corners[3], down)
            shares += [dr.lerp(start, end, left + (column + 0.5) / TILE) for column in range(_BLOCK)]
        return shares

    def _interpolated(self, block: _Block, rate: int, top: Any) -> list[list[Any]]:
        """Each pixel of a block, linear between the samples around it."""
        Int, Float = self.arrays.plain.Int, self.arrays.plain.Float
        places = [(p + 0.5) / (1 << rate) - 0.5 for p in range(_BLOCK)]
        if rate <= _BLOCK_RATE:
            # A block begins with a sample, so that all blocks have the same offsets and weights.
            base_x, base_y = Int(block.x >> rate), Int(block.y >> rate)
            first, last = int(np.floor(places[0])), int(np.ceil(places[-1]))
            across = down = [(int(np.floor(p)), p - np.floor(p)) for p in places]
        else:
            # Within a large sample a block lies on one side of the middle, where one does not end.
            start_x, start_y = (Float(v) * (1 / (1 << rate)) + places[0] for v in (block.x, block.y))
            base_x, base_y = Int(dr.floor(start_x)), Int(dr.floor(start_y))
            first, last = 0, 1
            across, down = (
                [(0, start - Float(base) + (p - places[0])) for p in places]
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
        """A sample, or the nearest one in the frame."""
        Int, UInt = self.arrays.plain.Int, self.arrays.plain.UInt
        last_x, last_y = (Int((size + ((1 << rate) - 1)) >> rate) - 1 for size in self._size)
        index = (top + UInt(dr.clip(y, 0, last_y))) * self._image_width + UInt(dr.clip(x, 0, last_x))
        return self.arrays.record(self._image, index, CHANNELS)[:3]


def _between(values: dict[Any, list[Any]], low: Any, high: Any, share: Any) -> list[Any]:
    if isinstance(share, float) and share == 0:
        return values[low]
    return [dr.lerp(a, b, share) for a, b in zip(values[low], values[high], strict=True)]


def _cell_corners(panels: Sequence[Panel]) -> Lattice:
    """Shares at the four corners of each cell, side by side, panel after panel."""
    shares = np.stack([panel.picture.share for panel in panels])
    corners = (np.s_[:, :-1, :-1], np.s_[:, :-1, 1:], np.s_[:, 1:, :-1], np.s_[:, 1:, 1:])
    return np.stack([shares[corner].ravel() for corner in corners], axis=1).ravel()


def _resized(mask: Mask, cell: int, tile: int) -> Mask:
    """Which tiles hold any set cell: both are squares of so many pixels, one a multiple of the other."""
    if tile < cell:
        return mask.repeat(cell // tile, axis=0).repeat(cell // tile, axis=1)
    size = tile // cell
    rows, columns = -(-mask.shape[0] // size), -(-mask.shape[1] // size)
    padded = np.zeros((rows * size, columns * size), dtype=bool)
    padded[: mask.shape[0], : mask.shape[1]] = mask
    return np.asarray(padded.reshape(rows, size, columns, size).any(axis=(1, 3)))


def _grown(mask: Mask) -> Mask:
    """The mask and its neighbours."""
    tall = mask.copy()
    tall[1:] |= mask[:-1]
    tall[:-1] |= mask[1:]
    grown = tall.copy()
    grown[:, 1:] |= tall[:, :-1]
    grown[:, :-1] |= tall[:, 1:]
    return grown
