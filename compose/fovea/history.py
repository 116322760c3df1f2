"""What the fovea has already seen: samples of earlier frames, which stay with the surfaces they hit.

While the camera stands still, samples add up pixel by pixel, wherever the gaze goes. When it moves, the
samples of the last frames move to where their hit points are visible now, each directly from the view that
traced it: nothing is resampled twice, so that nothing blurs or drifts however long the walk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.fovea.earlier import EarlierView, EarlierViews
from compose.fovea.record import (
    ALBEDO,
    COUNT,
    NORMAL,
    POSITIONS,
    RADIANCE,
    RECORD,
    SQUARES,
    add_features,
    add_light,
    limit,
    means,
)
from compose.fovea.reprojection import Reprojected, reproject
from compose.fovea.samples import Floats, Samples

# Samples, and sample positions of auxiliary features, per pixel of an earlier view: old errors fade.
_MOST_SAMPLES = 32.0
# Most sample positions in a pixel over which its auxiliary features are averaged.
_MOST_POSITIONS = 64
# What a view knows of a pixel besides what adds up: position and class of gloss of what its first sample hit.
_HIT = 4
_POINT, _GLOSS = slice(0, 3), 3
# Columns of a view's records and hits by their keys in saved states; files of interrupted videos contain
# these keys.
_SAVED_RECORDS: dict[str, int | slice] = {
    "count": COUNT,
    "light": slice(RADIANCE.start, SQUARES.stop),
    "places": POSITIONS,
    "guides": slice(ALBEDO.start, NORMAL.stop),
}
_SAVED_HITS: dict[str, int | slice] = {"position": _POINT, "gloss": _GLOSS}


class History:
    """Samples of all pixels of a view, as far as any have been traced.

    It is valid for one world: make another history when the scene changes.

    Args:
        arrays: the backend's array types.
    """

    def __init__(self, arrays: Arrays):
        self._view: _View | None = None
        self._earlier = EarlierViews(arrays)
        # What the earlier views contribute to the current one.
        self._past: Reprojected | None = None

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Arrays from which `restored` continues: those of the current view, without earlier views."""
        view = self._view
        if view is None:
            return {}
        known = {key: view.records[:, column] for key, column in _SAVED_RECORDS.items()}
        known |= {key: view.hits[:, column] for key, column in _SAVED_HITS.items()}
        known = {key: values.copy() for key, values in known.items()}
        return {**known, "gloss": known["gloss"].astype(np.uint8), "pattern": np.array([view.pattern])}

    @staticmethod
    def restored(arrays: Arrays, camera: Camera, state: dict[str, NDArray[np.generic]]) -> History:
        """A history of a camera's view from the `state` of another one."""
        history = History(arrays)
        view = history._view = _View.of(camera, int(state["pattern"][0]))  # type: ignore[call-overload]
        for key, column in _SAVED_RECORDS.items():
            view.records[:, column] = state[key]
        for key, column in _SAVED_HITS.items():
            view.hits[:, column] = state[key]
        view.known[:] = (view.records[:, COUNT] > 0) | (view.records[:, POSITIONS] > 0)
        return history

    def sampled(self, camera: Camera, pixels: NDArray[np.uint32], seed: int) -> tuple[NDArray[np.int64], int]:
        """(D,) number of samples that pixels (D,) have from this very camera, and the seed of their pattern.

        With these the tracer places further samples where earlier ones left gaps. A camera without samples
        has the seed that is passed in.
        """
        view = self._view_of(camera)
        if view is None:
            return np.zeros(len(pixels), dtype=np.int64), seed
        return view.records[pixels, COUNT].astype(np.int64), view.pattern

    def unseen(self, camera: Camera, pixels: NDArray[np.uint32], positions: int) -> NDArray[np.uint32]:
        """Those of some pixels whose auxiliary features should be traced (again).

        They are means over fewer sample positions than `positions`, or than the pixel has samples, up to 64.
        """
        view = self._view_of(camera)
        if view is None:
            return pixels
        known = self._records(view, pixels)
        wanted = np.clip(known[:, COUNT], positions, _MOST_POSITIONS)
        # Half a position: numbers of earlier views, which are scaled, are rounded.
        lacking = known[:, POSITIONS] < wanted - 0.5
        # What earlier views show is not where this one's samples hit.
        return pixels[lacking | (view.records[pixels, POSITIONS] == 0)]

    def see(self, camera: Camera, seen: Samples, positions: int, seed: int) -> None:
        """Makes the camera's view the current one, and adds auxiliary features of it.

        Args:
            camera: the view.
            seen: some pixels with newly traced auxiliary features; their light does not count.
            positions: number of sample positions of which these features are means.
            seed: of the samples to come.
        """
        self._view = self._entered(camera, seen, seed)
        self._view.add_features(seen, positions)

    def recall(self, pixels: NDArray[np.uint32]) -> Samples:
        """What is known of pixels (D,) of the current view, all of which have been seen."""
        view = self._current()
        count, radiance, squares, albedo, normal = means(self._records(view, pixels))
        hits = view.hits.take(pixels, axis=0)
        gloss = hits[:, _GLOSS].astype(np.uint8)
        return Samples(pixels, count, radiance, squares, albedo, normal, hits[:, _POINT], gloss)

    def remember(self, new: Samples) -> None:
        """Adds samples of the current view."""
        self._current().add_light(new)

    def _current(self) -> _View:
        assert self._view is not None, "nothing was seen"
        return self._view

    def _records(self, view: _View, pixels: NDArray[np.uint32]) -> Floats:
        """(D, 16) records of pixels of the current view, what earlier views contribute to them included."""
        records = view.records.take(pixels, axis=0)
        if self._past is not None:
            records += self._past.at(*np.divmod(pixels, np.uint32(view.camera.width)))
        return records

    def _view_of(self, camera: Camera) -> _View | None:
        """The current view if it is this camera's."""
        return self._view if self._view is not None and self._view.camera == camera else None

    def _entered(self, camera: Camera, seen: Samples, seed: int) -> _View:
        """The camera's view; the view before it, if of the same size, becomes an earlier one."""
        view = self._view
        if view is None or (view.camera.width, view.camera.height) != (camera.width, camera.height):
            self._earlier.clear()
            self._past = None
            view = _View.of(camera, seed)
        elif view.camera != camera:
            self._earlier.add(view.as_earlier())
            self._past = reproject(self._earlier, camera, seen)
            view.begin(camera, seed)
        return view


@dataclass
class _View:
    """What has been traced from one camera, for all N = H * W pixels.

    Attributes:
        camera: the view.
        pattern: seed of the pattern of its samples.
        records: (N, 16) (compose.fovea.record).
        hits: (N, 4) position and class of gloss of what the first sample hit.
        known: (N,) pixels of which anything is known.
    """

    camera: Camera
    pattern: int
    records: Floats
    hits: Floats
    known: NDArray[np.bool_]

    @staticmethod
    def of(camera: Camera, pattern: int) -> _View:
        """A view from which nothing has been traced yet."""
        size = camera.width * camera.height
        records, hits = (np.zeros((size, width), dtype=np.float32) for width in (RECORD, _HIT))
        return _View(camera, pattern, records, hits, np.zeros(size, dtype=bool))

    def begin(self, camera: Camera, pattern: int) -> None:
        """Becomes the view of another camera, from which nothing has been traced yet.

        The memory stays: as much of it anew in each frame takes longer than all that is written to it.
        """
        pixels = np.flatnonzero(self.known)
        self.records[pixels] = self.hits[pixels] = 0
        self.known[pixels] = False
        self.camera, self.pattern = camera, pattern

    def add_features(self, seen: Samples, positions: int) -> None:
        """Adds auxiliary features."""
        pixels = seen.pixels
        records = self.records.take(pixels, axis=0)
        first = np.flatnonzero(records[:, POSITIONS] == 0)
        self.hits[pixels[first]] = np.column_stack([seen.position[first], seen.gloss[first]])
        add_features(records, seen, positions)
        self.records[pixels] = records
        self.known[pixels] = True

    def add_light(self, new: Samples) -> None:
        """Adds samples of radiance."""
        records = self.records.take(new.pixels, axis=0)
        add_light(records, new)
        self.records[new.pixels] = records
        self.known[new.pixels] = True

    def as_earlier(self) -> EarlierView:
        """The pixels that have samples."""
        pixels = np.flatnonzero(self.known)
        pixels = pixels[self.records[pixels, COUNT] > 0]
        records, hits = self.records.take(pixels, axis=0), self.hits.take(pixels, axis=0)
        limit(records, _MOST_SAMPLES)
        return EarlierView(records, hits[:, _POINT], hits[:, _GLOSS].astype(np.uint8), self.camera.position)
