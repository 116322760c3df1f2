"""Film positions, the rays through them, and the lanes that trace several samples of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera


@dataclass(frozen=True)
class FilmPositions:
    """Places on the film to trace, each a box filter.

    Attributes:
        x, y: (N,) Dr.Jit floats, upper left corner of each box; a pixel's corner is its column and row.
        width, height: of the boxes in pixels, one for all or (N,) Dr.Jit floats.
    """

    x: Any
    y: Any
    width: Any = 1.0
    height: Any = 1.0

    @property
    def count(self) -> int:
        return dr.width(self.x)


def pixel_positions(indices: Any, width: int) -> FilmPositions:
    """Film positions of pixels given by their row-major index, a (N,) Dr.Jit unsigned integer array."""
    # Opaque, like all that may be another number in the next frame: a literal would be compiled in.
    columns = dr.opaque(mi.UInt32, width)
    row = indices // columns
    positions = FilmPositions(mi.Float(indices - row * columns), mi.Float(row))
    dr.eval(positions.x, positions.y)
    return positions


def box_positions(left: Any, top: Any, width: Any, height: Any) -> FilmPositions:
    """Film positions of boxes given by (N,) numpy arrays of their edges and sizes in pixels."""
    return FilmPositions(*(mi.Float(values.astype(np.float32)) for values in (left, top, width, height)))


def frame_positions(camera: Camera) -> FilmPositions:
    """Film positions of all pixels, row by row."""
    return pixel_positions(dr.arange(mi.UInt32, camera.width * camera.height), camera.width)


def interleaved(channels: list[Any]) -> NDArray[np.float32]:
    """(N, 3) of three (N,) Dr.Jit floats; one kernel, which is quicker than numpy."""
    values: NDArray[np.float32] = dr.ravel(mi.Point3f(*channels)).numpy()
    return values.reshape(-1, 3)
