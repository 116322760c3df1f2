"""Images of a forest on the device: of single layers at one sampling rate each, in an atlas; of a frame.

The nodes that may show in the cells in which images are drawn are selected by a table of the atlas. It is one
array: uploads cost as much as small kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, TypeVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.base.frozen import capacity
from compose.camera.camera import Camera
from compose.image.device_image import DeviceImage
from splat.raster.projection import PIXEL_FILTER, Footprints
from splat.raster.records import RecordLayout, Records, records_before
from splat.raster.tiles import TILE, TileGrid, between_corners

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt

Lattice = NDArray[np.float32]
Mask = NDArray[np.bool_]
_Kind = TypeVar("_Kind", bound=np.generic)
# Highest frequency that samples carry, in cycles per sample.
NYQUIST = 0.5
# In place of a layer: the nodes of the forest's hierarchy that levels ask for (`splat.raster.cut`).
CONTINUOUS = 0


@dataclass(frozen=True)
class LayerImage:
    """One layer at one sampling rate, and its weight in the frame."""

    layer: int  # 1, the coarsest, to L; or CONTINUOUS
    rate: int  # log2 of pixels per sample along each axis, 0 for every pixel
    # (rows + 1, columns + 1) weight in the frame, 0..1, at the corners of cells, linear between them
    weight: Lattice

    @staticmethod
    def whole(layer: int, rate: int, cells: tuple[int, ...]) -> LayerImage:
        """A layer alone over a frame of so many rows and columns of cells."""
        return LayerImage(layer, rate, np.ones((cells[0] + 1, cells[1] + 1), np.float32))


@dataclass(frozen=True)
class AtlasEntry:
    """A layer image's place in the atlas, the image that holds all layer images one above the other."""

    image: LayerImage  # what it shows
    top: int  # the row of samples in the atlas at which the frame's first row would be
    tiles: Mask  # (tile rows, tile columns) bool, its tiles that are drawn
    cells: Mask  # (rows, columns) bool, cells of TILE pixels of the frame in which its weight is not 0
    first_row: int = 0  # of its tiles, counted from the frame's; those above have no place in the atlas
    is_sharp: bool = False  # whether it keeps all that its samples carry, whatever the frame's cut-off

    @property
    def tile_rows(self) -> range:
        """Its rows of tiles in the atlas."""
        start = self.top // TILE + self.first_row
        return range(start, start + self.tiles.shape[0])


@dataclass(frozen=True)
class AtlasPart:
    """Entries of an atlas that make an image, and its rows of tiles."""

    entries: list[AtlasEntry]
    height: int

    @staticmethod
    def of(entries: list[AtlasEntry], step: int = 1) -> AtlasPart:
        """Some entries as an image whose height is a multiple of a number of tiles."""
        rows = sum(len(entry.tile_rows) for entry in entries)
        return AtlasPart(entries, -(-rows // step) * step)


@dataclass(frozen=True)
class Under:
    """What is drawn besides a frame, to lie under it: a layer at full rate with all that it resolves."""

    layer: int  # 1, the coarsest, to L; or CONTINUOUS
    cells: Mask  # (rows, columns) bool, cells of TILE pixels of the frame

    def entry(self, top: int) -> AtlasEntry:
        """Its entry in an atlas, whose first free row of samples is `top`; at least one cell is set."""
        rows = np.flatnonzero(self.cells.any(axis=1))
        first, end = int(rows[0]), int(rows[-1]) + 1
        image = LayerImage.whole(self.layer, 0, self.cells.shape)
        return AtlasEntry(image, top - first * TILE, self.cells[first:end], self.cells, first, True)


def pack_atlas(images: Sequence[LayerImage], wanted: Mask, top: int = 0) -> list[AtlasEntry]:
    """Atlas entries of the images that show in wanted cells (rows, columns), from row `top` of samples on."""
    entries = []
    for image in images:
        cells = covered_cells(image.weight) & wanted
        if cells.any():
            # At lower rates, a pixel at the border of a cell looks up samples beyond it.
            tiles = _joined(_grown(cells), 1 << image.rate) if image.rate else cells
            entries.append(AtlasEntry(image, top, tiles, cells))
            top += tiles.shape[0] * TILE
    return entries


def covered_cells(weight: Lattice) -> Mask:
    """(rows, columns) cells in which a weight, given at their corners, is not 0 everywhere."""
    return np.maximum.reduce(at_corners(weight)) > 0


def at_corners(lattice: NDArray[_Kind]) -> list[NDArray[_Kind]]:
    """A lattice at the four corners of each cell, (rows, columns) each."""
    return [lattice[:-1, :-1], lattice[1:, :-1], lattice[:-1, 1:], lattice[1:, 1:]]


def touched_corners(cells: Mask) -> Mask:
    """(rows + 1, columns + 1) the corners of cells that are set."""
    touched = np.zeros((cells.shape[0] + 1, cells.shape[1] + 1), dtype=bool)
    for corner in at_corners(touched):
        corner |= cells
    return touched


def _joined(mask: Mask, size: int) -> Mask:
    """Tiles of so many cells a side that hold any set cell of a mask (rows, columns)."""
    padded = np.pad(mask, [(0, -side % size) for side in mask.shape])
    blocks = padded.reshape(len(padded) // size, size, -1, size)
    return np.asarray(blocks.any(axis=(1, 3)))


def _grown(mask: Mask) -> Mask:
    """The mask and the eight neighbours of each of its cells; ten times as quick as SciPy's dilation."""
    tall = mask.copy()
    tall[1:] |= mask[:-1]
    tall[:-1] |= mask[1:]
    grown = tall.copy()
    grown[:, 1:] |= tall[:, :-1]
    grown[:, :-1] |= tall[:, 1:]
    return grown


@dataclass(frozen=True)
class SplatImage(DeviceImage):
    """An image of a forest, black where nothing is drawn."""

    nodes: int = 0  # Gaussians drawn, those in several layer images counted in each


def black_image(arrays: Arrays, camera: Camera, nodes: int = 0) -> SplatImage:
    """A black image of a camera's size."""
    grid = TileGrid(camera.width, camera.height)
    black = dr.zeros(arrays.plain.Float, grid.padded_width * grid.padded_height * 3)
    return SplatImage(arrays, black, camera.width, camera.height, grid.padded_width, nodes=nodes)


# Of an entry: its first candidate, and that one's number among all footprints; where its counts of cells and
# the cut-off lie in the array; for its selection the variance of the widest filter in px^2, and pixels by
# which boxes are enlarged; samples per pixel, minimum width of the filter as a multiple of the filter at the
# pixel grid, first row of samples, and bounds in tiles. Four floats are spare.
_INTEGERS = "start", "node", "counts", "cutoff"
_FLOAT_SLOTS = "widest", "margin", "scale", "least_blur", "offset", "columns", "top", "bottom"
_ENTRY = RecordLayout((8, 8), _INTEGERS, **dict.fromkeys((*_INTEGERS, *_FLOAT_SLOTS), 1))
_FLOATS = 16


@dataclass(frozen=True)
class EntryTable:
    """The entries of an atlas and their candidates: all footprints of their layers, entry by entry."""

    arrays: Arrays
    records: Records  # of the entries, and behind them their counts of cells and the cut-offs
    capacity: int  # of lanes, for the candidates
    entries: int
    corners: tuple[UInt, UInt]  # rows and columns of the corners of cells, of width 1
    candidates: UInt  # how many there are
    zero: UInt  # Dr.Jit copies what is read at a literal index to an array of its own

    @staticmethod
    def of_entries(
        arrays: Arrays,
        entries: Sequence[AtlasEntry],
        nodes: Sequence[range],
        blurs: Sequence[tuple[float, float]],
        cutoff: Lattice,
    ) -> EntryTable:
        """The table of some entries of an atlas, at least one.

        Args:
            entries: of the atlas.
            nodes: for each of them, where its layer's footprints lie among all.
            blurs: for each the widest and the narrowest filter, as multiples of the filter at the pixel grid.
            cutoff: (rows + 1, columns + 1) highest frequency to keep, in cycles per pixel, at the corners of
                cells of TILE pixels.
        """
        *starts, candidates = np.cumsum([0, *map(len, nodes)]).tolist()
        # Summed-area tables: counting the cells in a box takes four look-ups.
        counts = np.zeros((len(entries), *cutoff.shape), dtype=np.int32)
        cells = np.stack([entry.cells for entry in entries])
        np.cumsum(cells.cumsum(axis=1, dtype=np.int32), axis=2, out=counts[:, 1:, 1:])
        first = len(entries) * _FLOATS
        lattices = [cutoff]
        if any(entry.is_sharp for entry in entries):
            lattices.append(np.full_like(cutoff, NYQUIST))
        behind = first + counts.size
        rates = [entry.image.rate for entry in entries]
        rows = _ENTRY.rows(
            start=starts,
            node=[part.start for part in nodes],
            counts=[first + k * cutoff.size for k in range(len(entries))],
            cutoff=[behind + cutoff.size if entry.is_sharp else behind for entry in entries],
            widest=[PIXEL_FILTER * widest**2 for widest, _ in blurs],
            # At lower rates pixels look up samples that lie up to one sample away.
            margin=[2.0**rate if rate else 0.0 for rate in rates],
            scale=[0.5**rate for rate in rates],
            least_blur=[least for _, least in blurs],
            offset=[entry.top for entry in entries],
            columns=[entry.tiles.shape[1] for entry in entries],
            top=[entry.tile_rows.start for entry in entries],
            bottom=[entry.tile_rows.stop for entry in entries],
        )
        records = records_before(arrays, _ENTRY, rows, counts, *lattices)
        down, across, *numbers = map(arrays.constant, (*cutoff.shape, candidates, 0))
        return EntryTable(arrays, records, capacity(candidates), len(entries), (down, across), *numbers)

    def of(self, candidate: UInt) -> tuple[SimpleNamespace, UInt]:
        """The entries that candidates (M,) belong to, and their numbers among all footprints."""
        UInt = self.arrays.plain.UInt
        number = self.zero
        for k in range(1, self.entries):
            start = UInt(dr.reinterpret_array(UInt, self._at(self.zero + k * _FLOATS)))
            number = number + dr.select(candidate >= start, UInt(1), UInt(0))
        entry = self.records.at(number)
        return entry, candidate - entry.start + entry.node

    def cells(self, entry: SimpleNamespace, box: tuple[Float, Float, Float, Float], valid: Bool) -> UInt:
        """(M,) number of an entry's cells in boxes, 0 in those that are not valid.

        Boxes are left, top, right and bottom in pixels, clipped to the frame.
        """
        plain, (rows, columns) = self.arrays.plain, self.corners
        across, down = plain.Float(columns - 1), plain.Float(rows - 1)
        inside = lambda position, count: dr.clip(position * (1 / TILE), 0, count)  # noqa: E731
        left, top = plain.UInt(inside(box[0], across)), plain.UInt(inside(box[1], down))
        right, bottom = plain.UInt(dr.ceil(inside(box[2], across))), plain.UInt(dr.ceil(inside(box[3], down)))

        def at(row: UInt, column: UInt) -> UInt:
            return plain.UInt(
                dr.reinterpret_array(plain.UInt, self._at(entry.counts + row * columns + column, valid))
            )

        return at(bottom, right) - at(top, right) - at(bottom, left) + at(top, left)

    def cutoff(self, entry: SimpleNamespace, x: Float, y: Float) -> Float:
        """The cut-off, linear between the corners of cells, at positions in pixels."""
        return between_corners(self.arrays, self._at, entry.cutoff, self.corners, x, y)

    def _at(self, index: UInt, valid: Bool | bool = True) -> Float:
        return dr.gather(self.arrays.plain.Float, self.records.tables[0], index, valid)


def touching(arrays: Arrays, table: EntryTable, footprints: Callable[[UInt], Footprints]) -> Bool:
    """Mask of the candidates, up to the capacity, whose filtered box touches any cell of their entry."""
    candidate = dr.arange(arrays.plain.UInt, table.capacity)
    known = candidate < table.candidates
    entry, index = table.of(dr.select(known, candidate, 0))
    node = footprints(index)
    # Square of the distance, in standard deviations, beyond which alpha is below 1/255.
    extent = 2 * dr.log(dr.maximum(node.opacity * 255, 1))
    reach_x, reach_y = (
        dr.sqrt(extent * (variance + entry.widest)) + entry.margin for variance in (node.xx, node.yy)
    )
    # Rejects NaN and infinite boxes.
    finite = known & (extent > 0) & (reach_x + reach_y < np.inf)
    box = node.x - reach_x, node.y - reach_y, node.x + reach_x, node.y + reach_y
    return finite & (table.cells(entry, box, finite) > 0)


def chosen(arrays: Arrays, table: EntryTable, footprints: Records) -> tuple[UInt, UInt]:
    """The candidates that touch cells of their entries, in order, (N,), and the number up to each."""
    UInt = arrays.plain.UInt
    mask = touching(arrays, table, lambda index: Footprints(**vars(footprints.at(index))))
    one = dr.select(mask, UInt(1), UInt(0))
    dr.eval(one)
    end, found = dr.cumsum(one), dr.empty(UInt, table.capacity)
    dr.scatter(found, dr.arange(UInt, table.capacity), end - 1, one > 0, mode=dr.ReduceMode.Permute)
    dr.eval(found, end)
    return found, end
