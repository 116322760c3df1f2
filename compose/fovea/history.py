"""What the fovea has already seen: samples of earlier frames, which stay with the surfaces they hit.

While the camera stands still, samples add up pixel by pixel, wherever the gaze goes. When it moves, the
samples of the last frames move to where their hit points are visible now, each directly from the view that
traced it: nothing is resampled twice, so that nothing blurs or drifts however long the walk.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, compressed, uploaded
from compose.base.traced_samples import STILL, Moment
from compose.camera.camera import Camera
from compose.fovea.disc import Disc
from compose.fovea.reprojection import EarlierView, EarlierViews, Reprojected, reproject
from compose.fovea.samples import (
    ALBEDO,
    COUNT,
    NORMAL,
    POSITIONS,
    RADIANCE,
    RECORD,
    SQUARES,
    Samples,
    limited,
    means,
    with_features,
    with_light,
)

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

# Samples, and sample positions of auxiliary features, per pixel of an earlier view: old errors fade.
_MOST_SAMPLES = 32.0
# The same where something has moved since: light changes, too. On `room-moving`, fused, half a sample makes
# movers, what they uncover and their shadows 0.1 dB better than none; two make movers 1 dB worse.
MOST_LATER = 0.5
# Most sample positions in a pixel over which its auxiliary features are averaged.
_MOST_POSITIONS = 64
# What else a view knows of a pixel: position, gloss and mover of its first hit. Three floats are spare.
_HIT = 8
_POINT, _GLOSS, _MOVER = slice(0, 3), 3, 4
# What files of interrupted videos contain of a view: columns of its records (0) or hits (1), and as what.
_SAVED: dict[str, tuple[int, int | slice, type[np.generic]]] = {
    "count": (0, COUNT, np.float32),
    "light": (0, slice(RADIANCE.start, SQUARES.stop), np.float32),
    "places": (0, POSITIONS, np.float32),
    "guides": (0, slice(ALBEDO.start, NORMAL.stop), np.float32),
    "position": (1, _POINT, np.float32),
    "gloss": (1, _GLOSS, np.uint8),
    "mover": (1, _MOVER, np.uint16),
}


class History:
    """Samples of all pixels of a view, as far as any have been traced.

    It is valid for one world: make another history when the scene changes. Where things move in it along
    known courses, `show` says how far they are.
    """

    def __init__(self, arrays: Arrays):
        self._arrays = arrays
        self._view: _View | None = None
        self._earlier = EarlierViews(arrays)
        # What the earlier views contribute to the current one.
        self._past: Reprojected | None = None

    def state(self) -> dict[str, NDArray[Any]]:
        """Host arrays from which `restored` continues: those of the current view, without earlier views."""
        view = self._view
        if view is None:
            return {}
        tables = np.asarray(view.records).reshape(-1, RECORD), np.asarray(view.hits).reshape(-1, _HIT)
        known = {key: tables[of][:, column].astype(kind) for key, (of, column, kind) in _SAVED.items()}
        moment = {"time": np.array([view.moment.time]), "poses": view.moment.poses}
        return {**known, **moment, "pattern": np.array([view.pattern])}

    @staticmethod
    def restored(arrays: Arrays, camera: Camera, state: dict[str, NDArray[Any]]) -> History:
        """A history of a camera's view from the `state` of another one."""
        history = History(arrays)
        # Files of videos that earlier versions began know of nothing that moves.
        if "time" in state:
            history.show(Moment(float(state["time"][0]), state["poses"].astype(np.float64)))
        pattern = int(state["pattern"][0])
        view = history._view = _View(arrays, camera, history._earlier.moment, pattern)
        size = camera.width * camera.height
        tables = [np.zeros((size, width), dtype=np.float32) for width in (RECORD, _HIT)]
        for key, (of, column, _) in _SAVED.items():
            tables[of][:, column] = state.get(key, STILL) if of else state[key]
        view.records, view.hits = (uploaded(arrays.plain.Float, table) for table in tables)
        view.known = arrays.plain.Bool((tables[0][:, [COUNT, POSITIONS]] > 0).any(axis=1))
        return history

    def show(self, moment: Moment) -> None:
        """Says which moment is seen from now on."""
        self._earlier.moment = moment

    def sampled(self, camera: Camera, pixels: UInt, seed: int) -> tuple[UInt | int, int]:
        """UInt, samples that pixels (D,) have from this very camera, and the seed of their pattern.

        With these the tracer places further samples where earlier ones left gaps. A camera without samples
        has 0, one number for all, and the seed that is passed in.
        """
        view = self._view_of(camera)
        if view is None:
            return 0, seed
        count = self._arrays.plain.UInt(dr.gather(type(view.records), view.records, pixels * RECORD))
        dr.eval(count)
        return count, view.pattern

    def unseen(self, camera: Camera, pixels: UInt, positions: int) -> UInt:
        """Those of some pixels whose auxiliary features should be traced (again).

        They are means over fewer sample positions than `positions`, or than the pixel has samples, up to 64.
        """
        view = self._view_of(camera)
        if view is None:
            return pixels
        own = view.record(pixels)
        known = self._with_past(view, own, pixels)
        wanted = dr.clip(known[COUNT], positions, _MOST_POSITIONS)
        # Half a position: numbers of earlier views, which are scaled, are rounded.
        lacking = known[POSITIONS] < wanted - 0.5
        # What earlier views show is not where this one's samples hit.
        return compressed(pixels, lacking | (own[POSITIONS] == 0))

    def see(self, camera: Camera, seen: Samples, positions: int, seed: int, disc: Disc) -> None:
        """Makes the camera's view the current one; the one before, if of the same size, becomes earlier.

        Auxiliary features are added of some pixels `seen` in a disc, whose light does not count, as means
        over a number of sample positions. The seed is that of the samples to come.
        """
        view = self._view
        if view is None or (view.camera.width, view.camera.height) != (camera.width, camera.height):
            self._earlier.clear()
            self._past = None
            view = _View(self._arrays, camera, self._earlier.moment, seed)
        elif self._view_of(camera) is None:
            self._earlier.add(view.as_earlier(self._earlier.moment))
            assert disc.box is not None, "a view is entered with a pixel of it"
            self._past = reproject(self._earlier, camera, seen, disc.box)
            view.begin(camera, self._earlier.moment, seed)
        self._view = view
        if seen.size:
            view.add_features(seen, positions)

    def recall(self, pixels: UInt) -> Samples:
        """What is known of pixels (D,) of the current view, all of which have been seen."""
        view = self._current()
        own, hits = view.record(pixels), view.hit(pixels)
        known = self._with_past(view, own, pixels)
        earlier = known[COUNT] - own[COUNT]
        recalled = Samples(pixels, *means(known), hits[_POINT], hits[_GLOSS], hits[_MOVER], earlier)
        dr.eval(vars(recalled))
        return recalled

    def remember(self, new: Samples) -> None:
        """Adds light of the current view."""
        self._current().add_light(new)

    def _current(self) -> _View:
        assert self._view is not None, "nothing was seen"
        return self._view

    def _with_past(self, view: _View, records: list[Float], pixels: UInt) -> list[Float]:
        """Records of pixels (D,) of the current view with what earlier views contribute to them."""
        if self._past is None:
            return records
        past = self._past.at(pixels, view.camera.width)
        return [own + more for own, more in zip(records, past, strict=True)]

    def _view_of(self, camera: Camera) -> _View | None:
        """The current view if it is this camera's at this time."""
        view = self._view
        if view is None or view.camera != camera or view.moment.time != self._earlier.moment.time:
            return None
        return view


class _View:
    """What has been traced from one camera at a moment, for all N = H * W pixels.

    Flat Floats: N records (compose.fovea.samples), and hits: position, class of gloss and mover of what the
    first sample hit. `known`, Bool (N,), are pixels of which anything is known.
    """

    def __init__(self, arrays: Arrays, camera: Camera, moment: Moment, pattern: int):
        self._arrays, self.camera, self.moment, self.pattern = arrays, camera, moment, pattern
        size = camera.width * camera.height
        self.records, self.hits = (dr.zeros(arrays.plain.Float, width * size) for width in (RECORD, _HIT))
        self.known = dr.zeros(arrays.plain.Bool, size)

    def record(self, pixels: UInt) -> list[Float]:
        """Sixteen Floats (D,)."""
        return self._read(self.records, RECORD, pixels)

    def hit(self, pixels: UInt) -> list[Float]:
        """Eight Floats (D,), what the first samples hit."""
        return self._read(self.hits, _HIT, pixels)

    def _read(self, table: Float, size: int, pixels: UInt) -> list[Float]:
        found = list(self._arrays.packet(table, size, pixels))
        # What still waits to be read from a table would have all of it copied when it is written.
        dr.eval(found)
        return found

    def begin(self, camera: Camera, moment: Moment, pattern: int) -> None:
        """Becomes the view of another camera or moment, of which nothing has been traced yet.

        The memory stays: as much of it anew in each frame takes longer than all that is written to it.
        """
        plain = self._arrays.plain
        pixels = plain.UInt(dr.compress(self.known))
        if dr.width(pixels):
            for table, size in ((self.records, RECORD), (self.hits, _HIT)):
                self._arrays.put_packet(table, [plain.Float(0)] * size, pixels)
            dr.scatter(self.known, plain.Bool(False), pixels)
            dr.eval(self.records, self.hits, self.known)
        self.camera, self.moment, self.pattern = camera, moment, pattern

    def add_features(self, seen: Samples, positions: int) -> None:
        """Adds auxiliary features, means over a number of sample positions."""
        records, Float = self.record(seen.pixels), self._arrays.plain.Float
        first = records[POSITIONS] == 0
        hit = [*seen.position, seen.gloss, seen.mover, *[Float(0)] * (_HIT - 5)]
        number = Float(self._arrays.constant(positions))
        self._arrays.put_packet(self.hits, hit, seen.pixels, first)
        self._arrays.put_packet(self.records, with_features(records, seen, number), seen.pixels)
        dr.scatter(self.known, self._arrays.plain.Bool(True), seen.pixels)
        dr.eval(self.records, self.hits, self.known)

    def add_light(self, new: Samples) -> None:
        """Adds samples of radiance."""
        self._arrays.put_packet(self.records, with_light(self.record(new.pixels), new), new.pixels)
        dr.scatter(self.known, self._arrays.plain.Bool(True), new.pixels)
        dr.eval(self.records, self.known)

    def as_earlier(self, now: Moment) -> EarlierView:
        """The pixels that have samples, as they are worth now."""
        known = self._arrays.plain.UInt(dr.compress(self.known))
        pixels = compressed(known, self.record(known)[COUNT] > 0) if dr.width(known) else known
        viewpoint = self.camera.position
        if not dr.width(pixels):
            nothing = dr.zeros(self._arrays.plain.Float, 0)
            return EarlierView([], [], nothing, nothing, viewpoint, self.moment.time)
        most = _MOST_SAMPLES if now.time == self.moment.time else MOST_LATER
        records, hits = limited(self.record(pixels), most), self.hit(pixels)
        rest = self.moment.at_rest(self._arrays, hits[_POINT], hits[_MOVER])
        dr.eval(records, rest, hits)
        return EarlierView(records, rest, hits[_GLOSS], hits[_MOVER], viewpoint, self.moment.time)
