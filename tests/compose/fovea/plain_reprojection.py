"""The plain twin of compose.fovea.reprojection: numpy, float64, one view after another."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from compose.base.traced_samples import ALWAYS, DIFFUSE, SPECULAR, UNSTEADY, Moment
from compose.camera.camera import Camera
from tests.compose.arrays_of import Floats, PlainReprojected, PlainSamples, PlainView

# Relative difference of distances up to which two hits are taken for the same surface.
_SAME_SURFACE = 0.005
# Cosine of how far the direction of sight may turn until a surface shows something else, by class of gloss:
# any angle, 8 degrees and 0.2 degrees.
_LEAST_COSINE = np.cos(np.radians([180.0, 8.0, 0.2]))


def plain_reproject(
    views: Iterable[PlainView], camera: Camera, new: PlainSamples, moment: Moment = ALWAYS
) -> PlainReprojected | None:
    """What earlier views contribute to a camera's view, without what no longer holds.

    Args:
        views: the earlier views, at least one.
        camera: the view.
        new: samples of it, which show the surfaces that are visible now.
        moment: that they show.

    Returns:
        Sums over the rectangle around the new samples; None if no earlier sample holds.
    """
    surfaces = _Surfaces.of(camera, new)
    arrivals = _Arrivals.joined([_arrivals(view, camera, surfaces, moment) for view in views])
    if not len(arrivals.quarter):
        return None
    height, width = surfaces.nearest.shape
    # Whatever lies behind something nearer in the same quarter of a pixel is hidden by it.
    front = np.full(4 * height * width, np.inf)
    np.minimum.at(front, arrivals.quarter, arrivals.distance)
    seen = arrivals.certain | (arrivals.distance <= front[arrivals.quarter] * (1 + _SAME_SURFACE))
    down, across = np.divmod(arrivals.quarter[seen], 2 * width)
    target = down // 2 * width + across // 2
    records = _summed(target, arrivals.records[seen], height * width)
    return PlainReprojected(surfaces.rows, surfaces.columns, records.reshape(height, width, -1))


@dataclass(frozen=True)
class _Arrivals:
    """M samples of earlier views that are visible in a rectangle of a frame.

    Attributes:
        quarter: (M,) index of the quarter of a pixel, row by row over (2 h, 2 w) quarters.
        distance: (M,) from the camera.
        certain: (M,) whether nothing can hide it.
        records: (M, 16) (compose.fovea.samples).
    """

    quarter: NDArray[np.int64]
    distance: NDArray[np.float64]
    certain: NDArray[np.bool_]
    records: Floats

    @staticmethod
    def joined(parts: list[_Arrivals]) -> _Arrivals:
        return _Arrivals(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(_Arrivals)))


def _arrivals(view: PlainView, camera: Camera, surfaces: _Surfaces, moment: Moment) -> _Arrivals:
    """Samples of an earlier view in the rectangle of the visible surfaces, as far as they still hold."""
    pose = moment.poses[np.where(view.mover < len(moment.poses), view.mover, 0)]
    position = np.einsum("nij,nj->ni", pose[:, :, :3], view.position.astype(np.float64)) + pose[:, :, 3]
    pixel, depth = camera.project(position)
    height, width = surfaces.nearest.shape
    # In quarters of pixels: two along each axis.
    left, top = 2 * surfaces.columns.start, 2 * surfaces.rows.start
    across, down = 2 * pixel[:, 0] - left, 2 * pixel[:, 1] - top
    inside = (depth > 0) & (across >= 0) & (across < 2 * width) & (down >= 0) & (down < 2 * height)
    kept = np.flatnonzero(inside)
    across, down = across[kept].astype(np.int64), down[kept].astype(np.int64)
    sight, gloss = position[kept] - camera.position, view.gloss[kept]
    distance = _length(sight)
    # Whatever was visible from this very position still is.
    is_now = view.time == moment.time
    certain = is_now and bool((np.abs(view.viewpoint - camera.position) < 1e-6).all())
    if not certain:
        same = surfaces.contain(down // 2, across // 2, distance, gloss)
        shiny = np.flatnonzero(same & (gloss > DIFFUSE))
        cosine = _cosine(position[kept[shiny]] - view.viewpoint, sight[shiny])
        same[shiny] = cosine >= _LEAST_COSINE[gloss[shiny]]
        # Later, only what looks the same from everywhere does, if one knows where it is.
        same &= is_now | ((gloss == DIFFUSE) & (view.mover[kept] != UNSTEADY))
        kept, across, down, distance = kept[same], across[same], down[same], distance[same]
    return _Arrivals(
        quarter=down * 2 * width + across,
        distance=distance,
        certain=np.full(len(kept), certain),
        records=view.records[kept],
    )


@dataclass(frozen=True)
class _Surfaces:
    """The surfaces that new samples hit, around each pixel of the rectangle in which these lie.

    Attributes:
        rows, columns: the rectangle.
        nearest, farthest: (h, w) distances of what is visible in a pixel and in the eight around it.
        specular: (h, w) whether the pixel itself shows something that mirrors or refracts.
    """

    rows: slice
    columns: slice
    nearest: NDArray[np.float64]
    farthest: NDArray[np.float64]
    specular: NDArray[np.bool_]

    @staticmethod
    def of(camera: Camera, new: PlainSamples) -> _Surfaces:
        """The surfaces that samples of a camera's view hit."""
        rows, columns = new.box(camera.width)
        row, column = np.divmod(new.pixels.astype(np.int64), camera.width)
        row, column = row - rows.start, column - columns.start
        shape = rows.stop - rows.start, columns.stop - columns.start
        distance = _length(new.position - camera.position)
        specular = np.zeros(shape, dtype=bool)
        specular[row, column] = new.gloss == SPECULAR
        padded = shape[0] + 2, shape[1] + 2
        near, far = np.full(padded, np.inf), np.zeros(padded)
        near[row + 1, column + 1] = far[row + 1, column + 1] = distance
        nearest, farthest = _extreme_of_nine(near, np.minimum), _extreme_of_nine(far, np.maximum)
        return _Surfaces(rows, columns, nearest, farthest, specular)

    def contain(
        self,
        row: NDArray[np.int64],
        column: NDArray[np.int64],
        distance: NDArray[np.float64],
        gloss: NDArray[np.uint8],
    ) -> NDArray[np.bool_]:
        """(M,) whether hits at distances in pixels, of classes of gloss, lie on these surfaces; (M,) each."""
        same = distance >= self.nearest[row, column] * (1 - _SAME_SURFACE)
        same &= distance <= self.farthest[row, column] * (1 + _SAME_SURFACE)
        # Specular objects are thin in places, and what is visible beside them is far behind them.
        return same & (~self.specular[row, column] | (gloss == SPECULAR))


def _extreme_of_nine(image: NDArray[np.float64], choose: np.ufunc) -> NDArray[np.float64]:
    """(h, w) least or greatest of each inner pixel of an image (h + 2, w + 2) and the eight around it."""
    across = choose(choose(image[:, :-2], image[:, 1:-1]), image[:, 2:])
    return choose(choose(across[:-2], across[1:-1]), across[2:])


def _summed(target: NDArray[np.int64], values: Floats, size: int) -> NDArray[np.float64]:
    """(size, C) sums of values (M, C) by their target (M,)."""
    return np.stack([np.bincount(target, column, size) for column in values.T], axis=1)


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) lengths of (N, 3) vectors; faster than numpy's norm along so short an axis."""
    x, y, z = vectors.T
    return np.sqrt(x * x + y * y + z * z)


def _cosine(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) cosines of the angles between (N, 3) vectors."""
    return np.einsum("ni,ni->n", one, other) / (_length(one) * _length(other))
