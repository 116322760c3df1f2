"""Selects the nodes that may show in the cells of the frame in which their images are drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from splat.lod.entry_table import EntryTable
from splat.raster.projection import Footprints


def touching(arrays: Arrays, table: EntryTable, footprints: Callable[[Any], Footprints]) -> Any:
    """Mask of the candidates whose filtered box touches any cell of their entry.

    Args:
        arrays: the backend's array types.
        table: the entries and their candidates, at least one.
        footprints: those with the given numbers.
    """
    entry, index = table.of(dr.arange(arrays.plain.UInt, table.candidates))
    node = footprints(index)
    # Square of the distance, in standard deviations, beyond which alpha is below 1/255.
    extent = 2 * dr.log(dr.maximum(node.opacity * 255, 1))
    reach_x, reach_y = (
        dr.sqrt(extent * (variance + entry.widest)) + entry.margin for variance in (node.xx, node.yy)
    )
    # Rejects NaN and infinite boxes.
    finite = (extent > 0) & (reach_x + reach_y < np.inf)
    box = node.x - reach_x, node.y - reach_y, node.x + reach_x, node.y + reach_y
    return finite & (table.cells(entry, box, finite) > 0)
