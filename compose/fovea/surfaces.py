"""The surfaces that are visible around each pixel of a rectangle, and whether earlier samples lie on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.fovea.samples import Samples
from compose.image.gloss import SPECULAR

# Relative difference of distances up to which two hits are taken for the same surface.
SAME_SURFACE = 0.005
# Floats of a pixel that has been sampled, and of the surfaces around a pixel.
_SAMPLED, _AROUND = 2, 4


@dataclass(frozen=True)
class VisibleSurfaces:
    """The surfaces that samples of a view hit, around each pixel of the rectangle in which these lie.

    Attributes:
        arrays: the backend's array types.
        rows, columns: the rectangle.
        table: flat Float, for each of its pixels, row by row: the least and the greatest distance at which a
            surface may be that is visible in it or in the eight around it; 1 if the pixel itself shows
            something that mirrors or refracts, else 0; and 0.
    """

    arrays: Arrays
    rows: slice
    columns: slice
    table: Any

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w), the number of rows and columns."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    @staticmethod
    def of(arrays: Arrays, camera: Camera, new: Samples, box: tuple[slice, slice]) -> VisibleSurfaces:
        """The surfaces that samples of a camera's view hit, at least one sample.

        Args:
            arrays: the backend's array types.
            camera: the view.
            new: the samples.
            box: rows and columns in which all of these lie.
        """
        rows, columns = box
        height, width = rows.stop - rows.start, columns.stop - columns.start
        # A frame of one pixel around the rectangle spares its edges a test.
        row = new.pixels // arrays.constant(camera.width)
        column = new.pixels - row * arrays.constant(camera.width)
        corner = arrays.constant(rows.start), arrays.constant(columns.start)
        target = (row - corner[0] + 1) * arrays.constant(width + 2) + (column - corner[1] + 1)
        sampled = _sampled(arrays, camera, new, target, (height + 2) * (width + 2))
        return VisibleSurfaces(arrays, rows, columns, _around(arrays, sampled, height, width))

    def contain(self, pixel: Any, distance: Any, gloss: Any, active: Any) -> Any:
        """Whether hits lie on these surfaces.

        Args:
            pixel: UInt (M,), index of a pixel of the rectangle.
            distance: Float (M,), from the camera.
            gloss: UInt (M,), class of gloss of what is hit.
            active: Bool (M,), the hits in question.
        """
        around = dr.gather(
            self.arrays.plain.ArrayXf, self.table, pixel, active, shape=(_AROUND, dr.width(pixel))
        )
        same = active & (distance >= around[0]) & (distance <= around[1])
        # Specular objects are thin in places, and what is visible beside them is far behind them.
        return same & ((around[2] == 0) | (gloss == SPECULAR))


def _sampled(arrays: Arrays, camera: Camera, new: Samples, target: Any, size: int) -> Any:
    """Flat Float of `size` pixels: distance of what a sample hits, or -1; and 1 if that is specular."""
    plain = arrays.plain
    eye = [dr.opaque(plain.Float64, value) for value in camera.position.tolist()]
    sight = [plain.Float64(at) - origin for at, origin in zip(new.position, eye, strict=True)]
    distance = plain.Float(dr.sqrt(sum(side * side for side in sight)))
    specular = dr.select(new.gloss == SPECULAR, plain.Float(1), 0)
    table = dr.full(plain.Float, -1, _SAMPLED * size)
    values = plain.ArrayXf([distance, specular])
    dr.scatter(table, values, target, mode=dr.ReduceMode.Permute)
    dr.eval(table)
    return table


def _around(arrays: Arrays, sampled: Any, height: int, width: int) -> Any:
    """Table of the surfaces around each pixel, from that of the pixels and of a frame around them."""
    plain = arrays.plain
    index, across, stride = (
        dr.arange(plain.UInt, height * width),
        arrays.constant(width),
        arrays.constant(width + 2),
    )
    row = index // across
    corner = row * stride + (index - row * across)
    nearest, farthest = plain.Float(np.inf), plain.Float(0)
    for neighbour in range(9):
        at = corner + neighbour // 3 * stride + neighbour % 3
        distance = dr.gather(plain.Float, sampled, at * _SAMPLED)
        nearest = dr.minimum(nearest, dr.select(distance < 0, np.inf, distance))
        farthest = dr.maximum(farthest, distance)
    specular = dr.gather(plain.Float, sampled, (corner + stride + 1) * _SAMPLED + 1)
    around = [nearest * (1 - SAME_SURFACE), farthest * (1 + SAME_SURFACE), dr.maximum(specular, 0)]
    table = dr.empty(plain.Float, _AROUND * height * width)
    values = plain.ArrayXf([*around, plain.Float(0)])
    dr.scatter(table, values, index, mode=dr.ReduceMode.Permute)
    dr.eval(table)
    return table
