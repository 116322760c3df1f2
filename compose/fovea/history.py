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
from compose.fovea.light import LIGHT, light_of, means
from compose.fovea.reprojection import Reprojected, reproject
from compose.fovea.samples import Floats, Samples

# Samples per pixel of an earlier view: old errors fade.
_MOST_SAMPLES = 32.0
# Most sample positions in a pixel over which its auxiliary features are averaged.
_MOST_POSITIONS = 64
# What a view knows of a pixel, besides its light: the number of sample positions whose auxiliary features are
# known, sums of their albedo and normal, and position and class of gloss of what one of them hits.
_FEATURES = 11
_POSITIONS, _AUXILIARY, _HIT, _GLOSS = 0, slice(1, 7), slice(7, 10), 10
# Columns of a view's light and of its features by their keys in saved states; files of interrupted videos
# contain these keys.
_SAVED_LIGHT: dict[str, int | slice] = {"count": 0, "light": slice(1, 7)}
_SAVED_FEATURES: dict[str, int | slice] = {
    "places": _POSITIONS,
    "guides": _AUXILIARY,
    "position": _HIT,
    "gloss": _GLOSS,
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
        view = self._view
        if view is None:
            return {}
        known = {key: view.light[:, column] for key, column in _SAVED_LIGHT.items()}
        known |= {key: view.features[:, column] for key, column in _SAVED_FEATURES.items()}
        known = {key: values.copy() for key, values in known.items()}
        return {**known, "gloss": known["gloss"].astype(np.uint8), "pattern": np.array([view.pattern])}

    @staticmethod
    def restored(arrays: Arrays, camera: Camera, state: dict[str, NDArray[np.generic]]) -> History:
        """A history of a camera's view from the `state` of another one."""
        history = History(arrays)
        view = history._view = _View.of(camera, int(state["pattern"][0]))  # type: ignore[call-overload]
        for key, column in _SAVED_LIGHT.items():
            view.light[:, column] = state[key]
        for key, column in _SAVED_FEATURES.items():
            view.features[:, column] = state[key]
        view.known[:] = (view.light[:, 0] > 0) | (view.features[:, _POSITIONS] > 0)
        return history

    def sampled(self, camera: Camera, pixels: NDArray[np.uint32], seed: int) -> tuple[NDArray[np.int64], int]:
        """(D,) number of samples that pixels (D,) have from this very camera, and the seed of their pattern.

        With these the tracer places further samples where earlier ones left gaps. A camera without samples
        has the seed that is passed in.
        """
        view = self._view_of(camera)
        if view is None:
            return np.zeros(len(pixels), dtype=np.int64), seed
        return view.light[pixels, 0].astype(np.int64), view.pattern

    def unseen(self, camera: Camera, pixels: NDArray[np.uint32], positions: int) -> NDArray[np.uint32]:
        """Those of some pixels whose auxiliary features should be traced (again).

        They are means over fewer sample positions than `positions`, or than the pixel has samples, up to 64.
        """
        view = self._view_of(camera)
        if view is None:
            return pixels
        wanted = np.clip(view.light[pixels, 0], positions, _MOST_POSITIONS)
        return pixels[view.features[pixels, _POSITIONS] < wanted]

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
        view.add_features(seen, positions)
        light, features = view.light.take(pixels, axis=0), view.features.take(pixels, axis=0)
        if self._past is not None:
            light += self._past.at(*np.divmod(pixels, np.uint32(camera.width)))
        count, radiance, squares = means(light)
        auxiliary = features[:, _AUXILIARY] / features[:, [_POSITIONS]]
        return Samples(
            pixels=pixels,
            count=count,
            radiance=radiance,
            squares=squares,
            albedo=auxiliary[:, 0:3],
            normal=auxiliary[:, 3:6],
            position=features[:, _HIT],
            gloss=features[:, _GLOSS].astype(np.uint8),
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
            view.begin(camera, seed)
        self._view = view
        return view


@dataclass
class _View:
    """What has been traced from one camera, for all N = H * W pixels.

    Attributes:
        camera: the view.
        pattern: seed of the pattern of its samples.
        light: (N, 8) records (compose.fovea.light).
        features: (N, 11) what is known besides; see above.
        known: (N,) pixels of which anything is known.
    """

    camera: Camera
    pattern: int
    light: Floats
    features: Floats
    known: NDArray[np.bool_]

    @staticmethod
    def of(camera: Camera, pattern: int) -> _View:
        """A view from which nothing has been traced yet."""
        size = camera.width * camera.height
        light, features = (np.zeros((size, width), dtype=np.float32) for width in (LIGHT, _FEATURES))
        return _View(camera, pattern, light, features, np.zeros(size, dtype=bool))

    def begin(self, camera: Camera, pattern: int) -> None:
        """Becomes the view of another camera, from which nothing has been traced yet.

        The memory stays: as much of it anew in each frame takes longer than all that is written to it.
        """
        pixels = np.flatnonzero(self.known)
        self.light[pixels] = self.features[pixels] = 0
        self.known[pixels] = False
        self.camera, self.pattern = camera, pattern

    def add_features(self, seen: Samples, positions: int) -> None:
        """Adds auxiliary features, which are traced anew for each camera: reprojected ones are less exact."""
        pixels = seen.pixels
        features = self.features.take(pixels, axis=0)
        first = features[:, _POSITIONS] == 0
        features[first, _HIT], features[first, _GLOSS] = seen.position[first], seen.gloss[first]
        features[:, _AUXILIARY][:, 0:3] += seen.albedo * positions
        features[:, _AUXILIARY][:, 3:6] += seen.normal * positions
        features[:, _POSITIONS] += positions
        self.features[pixels] = features
        self.known[pixels] = True

    def add_light(self, new: Samples) -> None:
        """Adds samples of radiance."""
        self.light[new.pixels] = self.light.take(new.pixels, axis=0) + light_of(new)
        self.known[new.pixels] = True

    def as_earlier(self) -> EarlierView:
        """The pixels that have samples."""
        pixels = np.flatnonzero(self.known)
        pixels = pixels[self.light[pixels, 0] > 0]
        light, features = self.light.take(pixels, axis=0), self.features.take(pixels, axis=0)
        light *= np.minimum(_MOST_SAMPLES / light[:, :1], 1)
        return EarlierView(
            light, features[:, _HIT], features[:, _GLOSS].astype(np.uint8), self.camera.position
        )
