"""Chooses the views to train on: each shows most of what those before it did not show as well.

Surfaces are divided into patches. Viewers, spread over the region, say how much each patch matters, and how
finely it must be shown: each of their pixels asks for its patch at its own resolution. A view answers those
that ask for no more than twice its own. The first view that answers a pixel is worth 1, each further one 0.4
times the one before. Such a sum is submodular: taking the best view at each turn comes within 1 - 1/e of the
best set (Nemhauser, Wolsey, Fisher 1978).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Array, Camera
from pathtrace.region.looks import Looks, looks_of
from pathtrace.scene.triangles import Surfaces

_Numbers = NDArray[np.int64]

# Viewers, candidates for a round of views, and the views that a round gives.
_VIEWERS, _CANDIDATES, _ROUND = 768, 768, 192
# Side of the coarse frames in which patches are counted, in pixels.
_SIDE = 20
# What a further view of the same is worth.
_AGAIN = 0.4
# Levels of resolution: log2 of frame heights per unit of length, in steps of a half. So many levels below
# what is asked for will do.
_PER_OCTAVE, _COARSER = 2.0, 2
_LOWEST, _LEVELS = -64, 128
# Cells along each axis that a key can tell apart; farther ones share theirs.
_CELLS = 1 << 16


class Selection:
    """Chooses views of a region.

    Args:
        surfaces: the scene's.
        patch: side of a patch in units of the scene.
        origin: (3,) point amid the scene.
        viewers: where viewers may be, and the camera they have.
    """

    def __init__(self, surfaces: Surfaces, patch: float, origin: Array, viewers: tuple[Looks, Camera]):
        self._surfaces, self._patch, self._origin = surfaces, patch, origin
        patches, level, _ = self._pixels(*viewers)
        # Ordered by patch, then by level: what a view answers of a patch is a range.
        self._asked, pixels = np.unique(patches * _LEVELS + level, return_counts=True)
        self._weight = pixels / max(pixels.sum(), 1)

    @staticmethod
    def viewers() -> int:
        """How many viewers a selection needs."""
        return _VIEWERS

    def chosen(
        self, count: int, first: list[Camera], like: Camera, draw: Callable[[int, int], Looks]
    ) -> list[Camera]:
        """Views, best first; the first views are the same whatever their number.

        Args:
            count: number of views.
            first: views that are taken without a choice.
            like: has the intrinsics of the others.
            draw: gives candidates, at least one, from a number and the index of the round.
        """
        views = list(first[:count])
        lacking = self._weight.copy()
        for camera in views:
            lacking[self._answered(looks_of([camera]), camera)[0]] *= _AGAIN
        number = 0
        while len(views) < count:
            looks = draw(_CANDIDATES, number)
            picks = min(_ROUND, len(looks), count - len(views))
            for index in self._best(self._answered(looks, like), len(looks), picks, lacking):
                views.append(looks.camera(index, like))
            number += 1
        return views

    def _best(self, answered: tuple[_Numbers, _Numbers], count: int, picks: int, lacking: Array) -> list[int]:
        """Indices of the best candidates in turn; takes what they answer from `lacking`."""
        asked, candidate = answered
        ends = np.searchsorted(candidate, np.arange(count + 1))
        is_left = np.ones(count, dtype=bool)
        found = []
        for _ in range(picks):
            gain = np.where(is_left, np.bincount(candidate, lacking[asked], minlength=count), -1.0)
            best = int(np.argmax(gain))
            found.append(best)
            is_left[best] = False
            lacking[asked[ends[best] : ends[best + 1]]] *= _AGAIN
        return found

    def _answered(self, looks: Looks, like: Camera) -> tuple[_Numbers, _Numbers]:
        """Index of what is asked for, and of the view, wherever a view answers it; ordered by views."""
        patches, level, view = self._pixels(looks, like)
        names, place = np.unique(patches, return_inverse=True)
        pairs, place = np.unique(view * len(names) + place, return_inverse=True)
        finest = np.zeros(len(pairs), dtype=np.int64)
        np.maximum.at(finest, place, level)
        patches, view = names[pairs % max(len(names), 1)], pairs // max(len(names), 1)
        start = np.searchsorted(self._asked, patches * _LEVELS)
        enough = np.minimum(finest + _COARSER, _LEVELS - 1)
        length = np.searchsorted(self._asked, patches * _LEVELS + enough, side="right") - start
        offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
        return np.repeat(start, length) + offset, np.repeat(view, length)

    def _pixels(self, looks: Looks, like: Camera) -> tuple[_Numbers, _Numbers, _Numbers]:
        """Patch, level of resolution and view of each pixel that shows a surface."""
        origins, directions = looks.rays(like, _SIDE)
        distance, normal = self._surfaces.hits(origins, directions)
        seen = np.flatnonzero(np.isfinite(distance) & (distance > 0))
        distance, normal, directions = distance[seen], normal[seen], directions[seen]
        cells = np.floor((origins[seen] + directions * distance[:, None] - self._origin) / self._patch)
        cells = np.clip(cells, -_CELLS, _CELLS - 1).astype(np.int64) + _CELLS
        # Both sides of a wall lie in one cell, and so do the walls of a corner.
        axis = np.argmax(np.abs(normal), axis=1)
        side = 2 * axis + (np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] > 0)
        # Three times 17 bits, six sides and 128 levels are 61 bits.
        patch = ((cells[:, 0] * (2 * _CELLS) + cells[:, 1]) * (2 * _CELLS) + cells[:, 2]) * 6 + side
        cosine = np.maximum(-np.sum(normal * directions, axis=1), 1e-6)
        focal = np.sqrt(like.fx * like.fy) / like.height
        octaves = np.log2(focal * np.sqrt(cosine) * self._patch / distance)
        level = np.clip(np.round(_PER_OCTAVE * octaves) - _LOWEST, 0, _LEVELS - 1)
        return patch, level.astype(np.int64), seen // _SIDE**2
