"""Selects the nodes that may show in the cells in which their images are drawn, by a table of the atlas.

The table is one array: uploads cost as much as small kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from compose.base.frozen import capacity
from splat.lod.layer_images import NYQUIST, AtlasEntry, Lattice
from splat.raster.projection import PIXEL_FILTER, Footprints
from splat.raster.records import RecordLayout, Records, records_before
from splat.raster.tiles import TILE, between_corners

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt

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
