"""Selects the nodes that may show in given cells of a frame."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from splat.lod.footprints import LayerFootprints
from splat.raster.projection import PIXEL_FILTER
from splat.raster.tiles import TILE


def touching(
    arrays: Arrays, nodes: LayerFootprints, cells: NDArray[np.bool_], blur: float, margin: float
) -> Any:
    """Mask (N,) of the nodes whose filtered box touches any of the cells.

    Args:
        arrays: the backend's array types.
        nodes: N nodes of one layer.
        cells: (rows, columns) bool, cells of TILE pixels.
        blur: width of the filter, as a multiple of the filter at the pixel grid.
        margin: pixels by which each box is enlarged.
    """
    UInt, Int = arrays.plain.UInt, arrays.plain.Int
    # Opaque like everything that changes with the gaze or the camera: a literal would be compiled in.
    widest = dr.opaque(arrays.plain.Float, PIXEL_FILTER * blur**2)
    reach_x, reach_y = (
        dr.sqrt(nodes.extent * (variance + widest)) + margin for variance in (nodes.xx, nodes.yy)
    )
    # Rejects NaN and infinite boxes.
    finite = (nodes.extent > 0) & (reach_x + reach_y < np.inf)
    rows, columns = cells.shape
    first = lambda position, count: UInt(dr.clip(position * (1 / TILE), 0, count))  # noqa: E731
    end = lambda position, count: UInt(dr.ceil(dr.clip(position * (1 / TILE), 0, count)))  # noqa: E731
    across, down = arrays.number(columns), arrays.number(rows)
    left, right = first(nodes.x - reach_x, across), end(nodes.x + reach_x, across)
    top, bottom = first(nodes.y - reach_y, down), end(nodes.y + reach_y, down)
    # A summed-area table: counting the cells in a box takes four look-ups.
    sums = np.zeros((rows + 1, columns + 1), dtype=np.int32)
    sums[1:, 1:] = cells.cumsum(axis=0).cumsum(axis=1)
    table = Int(sums.ravel())
    at = lambda row, column: dr.gather(Int, table, row * (across + 1) + column, finite)  # noqa: E731
    return finite & (at(bottom, right) - at(top, right) - at(bottom, left) + at(top, left) > 0)
