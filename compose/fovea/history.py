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
from compose.fovea.movers import STILL, Moment
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
# The same where something has moved since: light changes, too. On `room-moving`, fused, half a sample makes
# movers, what they uncover and their shadows 0.1 dB better than none; two make movers 1 dB worse.
MOST_LATER = 0.5
# Most sample positions in a pixel over which its auxiliary features are averaged.
_MOST_POSITIONS = 64
# What a view knows of a pixel besides what adds up: of what its first sample hit, position, gloss and mover.
_HIT = 5
_POINT, _GLOSS, _MOVER = slice(0, 3), 3, 4
# Columns of a view's records and hits by their keys in saved states; files of interrupted videos contain
# these keys.
_SAVED_RECORDS: dict[str, int | slice] = {
    "count": COUNT,
    "light": slice(RADIANCE.start, SQUARES.stop),
    "places": POSITIONS,
    "guides": slice(ALBEDO.start, NORMAL.stop),
}
_SAVED_HITS: dict[str, int | slice] = {"position": _POINT, "gloss": _GLOSS, "mover": _MOVER}
_SAVED_TYPES = {"gloss": np.uint8, "mover": np.uint16}


class History:
    """Samples of all pixels of a view, as far as any have been traced.

    It is valid for one world: make another history when the scene changes. Where things move in it along
    known courses, `show` says how far they are.

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
        known |= {key: known[key].astype(kind) for key, kind in _SAVED_TYPES.items()}
        moment = {"time": np.array([view.moment.time]), "poses": view.moment.poses}
        return {**known, **moment, "pattern": np.array([view.pattern])}

    @staticmethod
    def restored(arrays: Arrays, camera: Camera, state: dict[str, NDArray[np.generic]]) -> History:
        """A history of a camera's view from the `state` of another one."""
        history = History(arrays)
        # Files of videos that earlier versions began know of nothing that moves.
        if "time" in state:
            history.show(Moment(float(state["time"][0]), state["poses"].astype(np.float64)))  # type: ignore[arg-type]
        pattern = int(state["pattern"][0])  # type: ignore[call-overload]
        view = history._view = _View.of(camera, history._earlier.moment, pattern)
        for key, column in _SAVED_RECORDS.items():
            view.records[:, column] = state[key]
        for key, column in _SAVED_HITS.items():
            view.hits[:, column] = state.get(key, STILL)
        view.known[:] = (view.records[:, COUNT] > 0) | (view.records[:, POSITIONS] > 0)
        return history

    def show(self, moment: Moment) -> None:
        """Says which moment is seen from now on."""
        self._earlier.moment = moment

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
        mover = hits[:, _MOVER].astype(np.uint16)
        return Samples(pixels, count, radiance, squares, albedo, normal, hits[:, _POINT], gloss, mover)

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
        """The current view if it is this camera's at this time."""
        view = self._view
        if view is None or view.camera != camera or view.moment.time != self._earlier.moment.time:
            return None
        return view

    def _entered(self, camera: Camera, seen: Samples, seed: int) -> _View:
        """The camera's view now; the view before it, if of the same size, becomes an earlier one."""
        view = self._view
        if view is None or (view.camera.width, view.camera.height) != (camera.width, camera.height):
            self._earlier.clear()
            self._past = None
            view = _View.of(camera, self._earlier.moment, seed)
        elif self._view_of(camera) is None:
            self._earlier.add(view.as_earlier(self._earlier.moment))
            self._past = reproject(self._earlier, camera, seen)
            view.begin(camera, self._earlier.moment, seed)
        return view


@dataclass
class _View:
    """What has been traced from one camera, for all N = H * W pixels.

    Attributes:
        camera: the view.
        moment: that it shows.
        pattern: seed of the pattern of its samples.
        records: (N, 16) (compose.fovea.record).
        hits: (N, 5) position, class of gloss and mover of what the first sample hit.
        known: (N,) pixels of which anything is known.
    """

    camera: Camera
    moment: Moment
    pattern: int
    records: Floats
    hits: Floats
    known: NDArray[np.bool_]

    @staticmethod
    def of(camera: Camera, moment: Moment, pattern: int) -> _View:
        """A view from which nothing has been traced yet."""
        size = camera.width * camera.height
        records, hits = (np.zeros((size, width), dtype=np.float32) for width in (RECORD, _HIT))
        return _View(camera, moment, pattern, records, hits, np.zeros(size, dtype=bool))

    def begin(self, camera: Camera, moment: Moment, pattern: int) -> None:
        """Becomes the view of another camera or moment, of which nothing has been traced yet.

        The memory stays: as much of it anew in each frame takes longer than all that is written to it.
        """
        pixels = np.flatnonzero(self.known)
        self.records[pixels] = self.hits[pixels] = 0
        self.known[pixels] = False
        self.camera, self.moment, self.pattern = camera, moment, pattern

    def add_features(self, seen: Samples, positions: int) -> None:
        """Adds auxiliary features."""
        pixels = seen.pixels
        records = self.records.take(pixels, axis=0)
        first = np.flatnonzero(records[:, POSITIONS] == 0)
        self.hits[pixels[first]] = np.column_stack(
            [seen.position[first], seen.gloss[first], seen.mover[first]]
        )
        add_features(records, seen, positions)
        self.records[pixels] = records
        self.known[pixels] = True

    def add_light(self, new: Samples) -> None:
        """Adds samples of radiance."""
        records = self.records.take(new.pixels, axis=0)
        add_light(records, new)
        self.records[new.pixels] = records
        self.known[new.pixels] = True

    def as_earlier(self, now: Moment) -> EarlierView:
        """The pixels that have samples, as they are worth now."""
        pixels = np.flatnonzero(self.known)
        pixels = pixels[self.records[pixels, COUNT] > 0]
        records, hits = self.records.take(pixels, axis=0), self.hits.take(pixels, axis=0)
        limit(records, _MOST_SAMPLES if now.time == self.moment.time else MOST_LATER)
        gloss, mover = hits[:, _GLOSS].astype(np.uint8), hits[:, _MOVER].astype(np.uint16)
        rest = self.moment.at_rest(hits[:, _POINT], mover)
        return EarlierView(records, rest, gloss, mover, self.camera.position, self.moment.time)
