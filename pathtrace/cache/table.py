"""Hash tables of cells: built with NumPy, searched with Dr.Jit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

# Places that are searched for a cell, from the one that its first name selects on.
_PROBES = 4
# Places for each cell, at least.
_ROOM = 3


@dataclass(frozen=True, eq=False)
class Table:
    """Where cells are found by their names; open addressing.

    Attributes:
        names: (T,) second name of the cell at each place; 0 where there is none. T is a power of two.
        indices: (T,) index of that cell.
    """

    names: NDArray[np.uint32]
    indices: NDArray[np.uint32]

    @staticmethod
    def of(first: NDArray[np.uint32], second: NDArray[np.uint32]) -> Table:
        """A table of cells by their two names (C,) each."""
        size = 1 << max(4, int(np.ceil(np.log2(_ROOM * len(first) + 1))))
        while True:
            table = Table(np.zeros(size, np.uint32), np.zeros(size, np.uint32))
            if table._holds(first, second):
                return table
            size *= 2

    @cached_property
    def arrays(self) -> tuple[Any, Any]:
        """The table as Dr.Jit arrays for `find`."""
        return mi.UInt32(self.names), mi.UInt32(self.indices)

    def _holds(self, first: NDArray[np.uint32], second: NDArray[np.uint32]) -> bool:
        """Puts the cells into the table; False if it is too full."""
        waiting = np.arange(len(first))
        for probe in range(_PROBES):
            here = (first[waiting].astype(np.int64) + probe) & (len(self.names) - 1)
            # Of the cells that want the same place, the first gets it.
            _, winner = np.unique(here, return_index=True)
            winner = winner[self.names[here[winner]] == 0]
            self.names[here[winner]] = second[waiting[winner]]
            self.indices[here[winner]] = waiting[winner]
            waiting = np.delete(waiting, winner)
        return not len(waiting)


def find(table: tuple[Any, Any], first: Any, second: Any, active: Any) -> tuple[Any, Any]:
    """Whether a `Table` has N cells, given by their names, and their indices (0 where it has not)."""
    names, indices = table
    last = dr.width(names) - 1
    known, place = mi.Bool(False), mi.UInt32(0)
    for probe in range(_PROBES):
        here = (first + probe) & last
        asks = active & ~known
        found = asks & (dr.gather(mi.UInt32, names, here, asks) == second)
        place = dr.select(found, here, place)
        known |= found
    return known, dr.gather(mi.UInt32, indices, place, known)
