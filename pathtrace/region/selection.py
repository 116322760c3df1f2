"""Chooses the views to train on: each shows most of what those before it did not show as well.

Surfaces are divided into patches. Viewers, spread over the region, say how much each patch matters: by their
pixels that fall on it, all in all; and how finely it must be shown: by their pixels that fall on it where
they see it. A view's worth for a patch is the number of its own pixels there, in units of the latter. What
views are worth together grows with the logarithm of their sum, so that the second view of a patch is worth
less than the first of another one, and no view is worth nothing. Such a sum is submodular: taking the best
view at each turn comes within 1 - 1/e of the best set (Nemhauser, Wolsey, Fisher 1978).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Array, Camera
from pathtrace.region.looks import Looks, looks_of
from pathtrace.scene.surfaces import Surfaces

_Keys = NDArray[np.int64]

# Viewers, candidates for a round of views, and the views that a round gives.
_VIEWERS, _CANDIDATES, _ROUND = 768, 768, 192
# Side of the coarse frames in which patches are counted, in pixels.
_SIDE = 18
# Views of a patch as fine as its viewers see it; so many of them are worth twice as much as none.
_GAIN = 1.0
# No view counts for more than so many viewers' on a patch: it still shows only one side of it.
_MOST = 2.0
# Cells along each axis that a key can tell apart; farther ones share theirs.
_CELLS = 1 << 19


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
        looks, like = viewers
        patches, _, pixels = self._counts(looks, like)
        self._patches, place = np.unique(patches, return_inverse=True)
        total = np.bincount(place, pixels, minlength=len(self._patches))
        seen_by = np.bincount(place, minlength=len(self._patches))
        self._weight = total / max(total.sum(), 1)
        self._fine = total / np.maximum(seen_by, 1)

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
            draw: gives candidates from a number and the index of the round.
        """
        views = list(first[:count])
        shown = np.zeros(len(self._patches))
        for camera in views:
            shown += self._worth(looks_of([camera]), camera).sum(axis=0)
        number = 0
        while len(views) < count:
            looks = draw(_CANDIDATES, number)
            picks = min(_ROUND, len(looks), count - len(views))
            for index in self._best(self._sparse(looks, like), len(looks), picks, shown):
                views.append(looks.camera(index, like))
            number += 1
        return views

    def _best(self, sparse: tuple[_Keys, _Keys, Array], count: int, picks: int, shown: Array) -> list[int]:
        """Indices of the best candidates in turn; adds what they show to `shown`."""
        patch, candidate, worth = sparse
        ends = np.searchsorted(candidate, np.arange(count + 1))
        is_left = np.ones(count, dtype=bool)
        found = []
        for _ in range(picks):
            before = shown[patch]
            gains = self._weight[patch] * np.log1p(_GAIN * worth / (1 + _GAIN * before))
            gain = np.where(is_left, np.bincount(candidate, gains, minlength=count), -1.0)
            best = int(np.argmax(gain))
            found.append(best)
            is_left[best] = False
            mine = slice(ends[best], ends[best + 1])
            shown[patch[mine]] += worth[mine]
        return found

    def _sparse(self, looks: Looks, like: Camera) -> tuple[_Keys, _Keys, Array]:
        """Patch, view and worth of each patch that a view sees, ordered by views."""
        keys, view, pixels = self._counts(looks, like)
        place = np.minimum(np.searchsorted(self._patches, keys), max(len(self._patches) - 1, 0))
        known = self._patches[place] == keys if len(self._patches) else np.zeros(len(keys), dtype=bool)
        place, view, pixels = place[known], view[known], pixels[known]
        return place, view, np.minimum(pixels / self._fine[place], _MOST)

    def _worth(self, looks: Looks, like: Camera) -> Array:
        """(views, patches) what each view is worth for each patch."""
        patch, view, worth = self._sparse(looks, like)
        dense = np.zeros((len(looks), len(self._patches)))
        dense[view, patch] = worth
        return dense

    def _counts(self, looks: Looks, like: Camera) -> tuple[_Keys, _Keys, NDArray[np.int64]]:
        """Patch, view and number of pixels for each patch that a view sees, ordered by views."""
        origins, directions = looks.rays(like, _SIDE)
        distance, normal = self._surfaces.hits(origins, directions)
        seen = np.flatnonzero(np.isfinite(distance))
        points = origins[seen] + directions[seen] * distance[seen, None]
        cells = np.floor((points - self._origin) / self._patch)
        cells = np.clip(cells, -_CELLS, _CELLS - 1).astype(np.int64) + _CELLS
        # Both sides of a wall lie in one cell, and so do the walls of a corner.
        normal = normal[seen]
        axis = np.argmax(np.abs(normal), axis=1)
        side = 2 * axis + (np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] > 0)
        key = ((cells[:, 0] * (2 * _CELLS) + cells[:, 1]) * (2 * _CELLS) + cells[:, 2]) * 6
        # Two of 20 bits, one of 20 and six sides are 63 bits.
        key += side
        names, place = np.unique(key, return_inverse=True)
        pairs, pixels = np.unique((seen // _SIDE**2) * len(names) + place, return_counts=True)
        return names[pairs % max(len(names), 1)], pairs // max(len(names), 1), pixels
