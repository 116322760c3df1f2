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
from compose.fovea.reprojection import Reprojected, reproject
from compose.fovea.samples import Floats, Samples

# Samples per pixel of an earlier view: old errors fade.
_MOST_SAMPLES = 32.0
# Most sample positions in a pixel over which its auxiliary features are averaged.
_MOST_POSITIONS = 64
# Attributes of a view by their keys in saved states; files of interrupted videos contain these keys.
_SAVED = {
    "count": "count",
    "light": "light",
    "places": "positions",
    "guides": "auxiliary",
    "position": "hit",
    "gloss": "gloss",
}


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
        if self._view is None:
            return {}
        known = {key: getattr(self._view, name) for key, name in _SAVED.items()}
        return {**known, "pattern": np.array([self._view.pattern])}

    @staticmethod
    def restored(arrays: Arrays, camera: Camera, state: dict[str, NDArray[np.generic]]) -> History:
        """A history of a camera's view from the `state` of another one."""
        history = History(arrays)
        history._view = _View.of(camera, int(state["pattern"][0]))  # type: ignore[call-overload]
        for key, name in _SAVED.items():
            getattr(history._view, name)[:] = state[key]
        return history

    def sampled(self, camera: Camera, pixels: NDArray[np.uint32], seed: int) -> tuple[NDArray[np.int64], int]:
        """(D,) number of samples that pixels (D,) have from this very camera, and the seed of their pattern.

        With these the tracer places further samples where earlier ones left gaps. A camera without samples
        has the seed that is passed in.
        """
        view = self._view_of(camera)
        if view is None:
            return np.zeros(len(pixels), dtype=np.int64), seed
        return view.count[pixels].astype(np.int64), view.pattern

    def unseen(self, camera: Camera, pixels: NDArray[np.uint32], positions: int) -> NDArray[np.uint32]:
        """Those of some pixels whose auxiliary features should be traced (again).

        They are means over fewer sample positions than `positions`, or than the pixel has samples, up to 64.
        """
        view = self._view_of(camera)
        if view is None:
            return pixels
        wanted = np.clip(view.count[pixels], positions, _MOST_POSITIONS)
        return pixels[view.positions[pixels] < wanted]

    def recall(
        self, camera: Camera, pixels: NDArray[np.uint32], seen: Samples, positions: int, seed: int
    ) -> Samples:
        """What is known of pixels, and makes the camera's view the current one.

        Args:
            camera: the view.
            pixels: (D,) row-major indices.
            seen: newly traced auxiliary features, without light, of those pixels that are `unseen`.
            positions: number of sample positions of which these features are means.
            seed: of the samples to come.
        """
        view = self._entered(camera, seen, seed)
        view.add_auxiliary(seen, positions)
        auxiliary = view.auxiliary[pixels] / view.positions[pixels][:, None]  # (D, 6)
        count, light = view.count[pixels], view.light[pixels]  # (D,), (D, 6)
        if self._past is not None:
            index = pixels.astype(np.int64)
            more, past = self._past.at(index // camera.width, index % camera.width)
            count, light = count + more, light + past
        light = light / np.maximum(count, np.float32(1e-6))[:, None]
        return Samples(
            pixels=pixels,
            count=count,
            radiance=light[:, 0:3],
            squares=light[:, 3:6],
            albedo=auxiliary[:, 0:3],
            normal=auxiliary[:, 3:6],
            position=view.hit[pixels],
            gloss=view.gloss[pixels],
        )

    def remember(self, new: Samples) -> None:
        """Adds samples of the view that was recalled last."""
        assert self._view is not None, "nothing was recalled"
        self._view.add_light(new)

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
            view = _View.of(camera, seed)
        self._view = view
        return view


@dataclass
class _View:
    """What has been traced from one camera, for all N = H * W pixels.

    Attributes:
        camera: the view.
        pattern: seed of the pattern of its samples.
        count: (N,) samples.
        light: (N, 6) sums of their radiance and of its squares.
        positions: (N,) sample positions whose auxiliary features are known.
        auxiliary: (N, 6) sums of their albedo and normal.
        hit: (N, 3) in the world, where one of them appears to hit something.
        gloss: (N,) of what it hits.
    """

    camera: Camera
    pattern: int
    count: Floats
    light: Floats
    positions: Floats
    auxiliary: Floats
    hit: Floats
    gloss: NDArray[np.uint8]

    @staticmethod
    def of(camera: Camera, pattern: int) -> _View:
        """A view from which nothing has been traced yet."""
        size = camera.width * camera.height
        return _View(
            camera,
            pattern,
            count=np.zeros(size, dtype=np.float32),
            light=np.zeros((size, 6), dtype=np.float32),
            positions=np.zeros(size, dtype=np.float32),
            auxiliary=np.zeros((size, 6), dtype=np.float32),
            hit=np.zeros((size, 3), dtype=np.float32),
            gloss=np.zeros(size, dtype=np.uint8),
        )

    def add_auxiliary(self, seen: Samples, positions: int) -> None:
        """Adds auxiliary features, which are traced anew for each camera: reprojected ones are less exact."""
        pixels = seen.pixels
        first = self.positions[pixels] == 0
        self.hit[pixels[first]], self.gloss[pixels[first]] = seen.position[first], seen.gloss[first]
        self.auxiliary[pixels] += np.hstack([seen.albedo, seen.normal]) * positions
        self.positions[pixels] += positions

    def add_light(self, new: Samples) -> None:
        """Adds samples of radiance."""
        pixels = new.pixels
        self.light[pixels] += np.hstack([new.radiance, new.squares]) * new.count[:, None]
        self.count[pixels] += new.count

    def as_earlier(self) -> EarlierView:
        """The pixels that have samples."""
        pixels = np.flatnonzero(self.count)
        count = self.count[pixels]
        return EarlierView(
            np.minimum(count, _MOST_SAMPLES),
            self.light[pixels] / count[:, None],
            self.hit[pixels],
            self.gloss[pixels],
            self.camera.position,
        )
