"""Samples of earlier views, reprojected to where a camera sees them now."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.fovea.history import Array
from compose.fovea.samples import DIFFUSE, SPECULAR, Samples

# Nothing farther away counts as another surface if its distance differs by less, relatively.
_SAME_SURFACE = 0.005
# How far the direction of sight may turn until what shines there is another, by gloss: not at all limited,
# 8 and 0.2 degrees.
_LEAST_COSINE = np.cos(np.radians([180.0, 8.0, 0.2]))


@dataclass(frozen=True)
class EarlierView:
    """What was traced from one camera, for N of its pixels.

    Attributes:
        count: (N,) samples.
        light: (N, 6) means of radiance and squares.
        position: (N, 3) of what was hit.
        gloss: (N,) of that.
        place: (3,) where it was seen from.
    """

    count: Array
    light: Array
    position: Array
    gloss: NDArray[np.uint8]
    place: NDArray[np.float64]


@dataclass(frozen=True)
class Reprojected:
    """Sums over samples, for the pixels of a rectangle of a frame.

    Attributes:
        rows, columns: the rectangle.
        count: (h, w).
        sums: (h, w, 6) of radiance and squares, times count.
    """

    rows: slice
    columns: slice
    count: NDArray[np.float64]
    sums: NDArray[np.float64]

    def at(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> tuple[Array, Array]:
        """(D,) counts and (D, 6) sums of pixels; 0 outside of the rectangle."""
        count = np.zeros(len(row), dtype=np.float32)
        sums = np.zeros((len(row), 6), dtype=np.float32)
        inside = (row >= self.rows.start) & (row < self.rows.stop)
        inside &= (column >= self.columns.start) & (column < self.columns.stop)
        place = row[inside] - self.rows.start, column[inside] - self.columns.start
        count[inside], sums[inside] = self.count[place], self.sums[place]
        return count, sums


def reproject(views: Iterable[EarlierView], camera: Camera, new: Samples) -> Reprojected | None:
    """What earlier views tell of what a camera sees, without what no longer holds."""
    surfaces = _Surfaces.of(camera, new)
    landings = [_landing(view, camera, surfaces) for view in views]
    quarter, distance, certain, weight, light = map(np.concatenate, zip(*landings, strict=True))
    if not len(quarter):
        return None
    height, width = surfaces.nearest.shape
    # What lies behind something nearer in the same quarter of a pixel is hidden by it.
    front = np.full(4 * height * width, np.inf)
    np.minimum.at(front, quarter, distance)
    seen = certain | (distance <= front[quarter] * (1 + _SAME_SURFACE))
    down, across = np.divmod(quarter[seen], 2 * width)
    target = down // 2 * width + across // 2
    count, sums = _added_up(target, weight[seen], light[seen], height * width)
    return Reprojected(
        surfaces.rows,
        surfaces.columns,
        count.reshape(height, width),
        sums.reshape(height, width, 6),
    )


def _landing(view: EarlierView, camera: Camera, surfaces: _Surfaces) -> tuple[NDArray[Any], ...]:
    """Where samples of an earlier view are seen in the surfaces' rectangle, as far as they still hold.

    Returns:
        Of M samples: (M,) quarter of a pixel, row by row; (M,) distance; (M,) whether nothing may hide it;
        (M,) count; (M, 6) light.
    """
    pixel, depth = camera.project(view.position.astype(np.float64))
    height, width = surfaces.nearest.shape
    # In quarters of pixels.
    left, top = 2 * surfaces.columns.start, 2 * surfaces.rows.start
    across, down = 2 * pixel[:, 0] - left, 2 * pixel[:, 1] - top
    inside = (depth > 0) & (across >= 0) & (across < 2 * width) & (down >= 0) & (down < 2 * height)
    kept = np.flatnonzero(inside)
    across, down = across[kept].astype(np.int64), down[kept].astype(np.int64)
    sight, gloss = view.position[kept] - camera.position, view.gloss[kept]
    distance = _length(sight)
    # Whatever was seen from this very place is seen from it still.
    certain = bool((np.abs(view.place - camera.position) < 1e-6).all())
    if not certain:
        same = surfaces.has(down // 2, across // 2, distance, gloss)
        shiny = np.flatnonzero(same & (gloss > DIFFUSE))
        cosine = _cosine(view.position[kept[shiny]] - view.place, sight[shiny])
        same[shiny] = cosine >= _LEAST_COSINE[gloss[shiny]]
        kept, across, down, distance = kept[same], across[same], down[same], distance[same]
    return (
        down * 2 * width + across,
        distance,
        np.full(len(kept), certain),
        view.count[kept].astype(np.float64),
        view.light[kept],
    )


@dataclass(frozen=True)
class _Surfaces:
    """What new samples hit, around each pixel of the rectangle in which they lie.

    Attributes:
        rows, columns: the rectangle.
        nearest, farthest: (h, w) distances of what is seen in a pixel and in those around it.
        specular: (h, w) whether what mirrors or bends is seen there.
    """

    rows: slice
    columns: slice
    nearest: NDArray[np.float64]
    farthest: NDArray[np.float64]
    specular: NDArray[np.bool_]

    @staticmethod
    def of(camera: Camera, new: Samples) -> _Surfaces:
        """What some samples hit."""
        row, column = np.divmod(new.pixels.astype(np.int64), camera.width)
        rows = slice(int(row.min()), int(row.max()) + 1)
        columns = slice(int(column.min()), int(column.max()) + 1)
        row, column = row - rows.start, column - columns.start
        shape = rows.stop - rows.start, columns.stop - columns.start
        distance = _length(new.position - camera.position)
        specular = np.zeros(shape, dtype=bool)
        specular[row, column] = new.gloss == SPECULAR
        nearest = _around(shape, row, column, distance, np.inf, np.minimum)
        farthest = _around(shape, row, column, distance, 0.0, np.maximum)
        return _Surfaces(rows, columns, nearest, farthest, specular)

    def has(
        self,
        row: NDArray[np.int64],
        column: NDArray[np.int64],
        distance: NDArray[np.float64],
        gloss: NDArray[np.uint8],
    ) -> NDArray[np.bool_]:
        """(M,) whether what is at a distance in a pixel, with that gloss, is on what the new samples hit."""
        same = distance >= self.nearest[row, column] * (1 - _SAME_SURFACE)
        same &= distance <= self.farthest[row, column] * (1 + _SAME_SURFACE)
        # What mirrors or bends is thin here and there, and what is seen beside it is far behind.
        return same & (~self.specular[row, column] | (gloss == SPECULAR))


def _around(
    shape: tuple[int, int],
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    values: NDArray[np.float64],
    unknown: float,
    choose: np.ufunc,
) -> NDArray[np.float64]:
    """(h, w) of what is chosen among the values in a pixel and in the eight around it."""
    image = np.full((shape[0] + 2, shape[1] + 2), unknown)
    image[row + 1, column + 1] = values
    across = choose(choose(image[:, :-2], image[:, 1:-1]), image[:, 2:])
    return choose(choose(across[:-2], across[1:-1]), across[2:])


def _added_up(
    target: NDArray[np.int64], weight: NDArray[np.float64], values: Array, size: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(size,) sums of the weights and (size, C) of the weighted values that go to each target."""
    count = np.bincount(target, weight, size).astype(np.float64)
    sums = [np.bincount(target, weight * values[:, i], size) for i in range(values.shape[1])]
    return count, np.stack(sums, axis=1).astype(np.float64)


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) lengths of (N, 3) vectors; quicker than a norm along so short an axis."""
    x, y, z = vectors.T
    return np.sqrt(x * x + y * y + z * z)


def _cosine(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) of the angles between (N, 3) vectors each."""
    return np.einsum("ni,ni->n", one, other) / (_length(one) * _length(other))
