"""Patches: what lies in the same cells of all levels.

Cells of several levels overlap. What is known of a patch is known once and serves all cells that it lies in.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


@dataclass(frozen=True, eq=False)
class Patches:
    """P patches of C cells.

    Attributes:
        cells: (levels, P) index of the cell of each level that each lies in, ascending with the level; -1 for
            none.
        count: C, the number of cells.
    """

    cells: NDArray[np.int32]
    count: int

    @staticmethod
    def of(cells: NDArray[np.int64], count: int) -> tuple[Patches, NDArray[np.int32]]:
        """The patches of points, and the index (N,) of that of each point.

        Args:
            cells: (levels, N) cells of each point, -1 for none.
            count: C, the number of cells.
        """
        # Single numbers are sorted several times faster than columns.
        sizes = (count + 1,) * len(cells)
        names, patch = np.unique(np.ravel_multi_index(tuple(cells + 1), sizes), return_inverse=True)
        unique = np.stack(np.unravel_index(names, sizes)) - 1
        return Patches(unique.astype(np.int32), count), patch.astype(np.int32)

    def __len__(self) -> int:
        return self.cells.shape[1]

    @cached_property
    def regions(self) -> NDArray[np.int64]:
        """(P,) number from 0 on that is the same for the patches of one largest cell."""
        _, region = np.unique(self.cells.max(axis=0, initial=-1), return_inverse=True)
        return region.astype(np.int64)

    def averaging(self, numbers: NDArray[Any]) -> sparse.csr_array:
        """(C, P) matrix that makes means over cells of sums over patches, of `numbers` (P,) samples."""
        level, patch = np.nonzero(self.cells >= 0)
        cell = self.cells[level, patch]
        samples = np.maximum(np.bincount(cell, numbers[patch], self.count), 1)
        shares = (1 / samples[cell]).astype(np.float32)
        return sparse.csr_array((shares, (cell, patch)), (self.count, len(self)))


def sums_by(place: NDArray[Any], values: NDArray[Any], count: int) -> NDArray[np.float64]:
    """(count, 3) sums of values (N, 3) over the places (N,) that they belong to."""
    return np.stack([np.bincount(place, channel, count) for channel in values.T], axis=1)
