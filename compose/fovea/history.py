"""What the fovea has already seen: samples of earlier frames, carried along with the surfaces they hit.

While the camera stands still, samples add up pixel by pixel, wherever the gaze goes. When it moves, the
samples of the last frames go to where their places in the world are seen now, each from where it was traced:
nothing is resampled twice, so that nothing blurs or drifts however long the walk.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.fovea.reprojection import EarlierView, Reprojected, reproject
from compose.fovea.samples import Samples

Array = NDArray[np.float32]

# Views that a moving camera remembers, and samples per pixel of each: old errors fade.
_VIEWS = 16
_MOST_SAMPLES = 32.0
# Places of a pixel over which its auxiliary features are means, at most.
_MOST_PLACES = 64


# What is known of the pixels of a view.
_OF_PIXELS = ("count", "light", "places", "auxiliary features", "position", "gloss")


class History:
    """Samples of all pixels of a view, as far as anything has been seen of them.

    The world must not change: make another history then.
    """

    def __init__(self) -> None:
        self._camera: Camera | None = None
        # Earlier views, and what of them is seen now.
        self._views: deque[EarlierView] = deque(maxlen=_VIEWS)
        self._past: Reprojected | None = None

    def state(self) -> dict[str, NDArray[np.generic]]:
        """All that is known of the view that was recalled last, for `restored`; nothing of earlier views."""
        if self._camera is None:
            return {}
        known = {name: getattr(self, f"_{name}") for name in _OF_PIXELS}
        return {**known, "pattern": np.array([self._pattern])}

    @staticmethod
    def restored(camera: Camera, state: dict[str, NDArray[np.generic]]) -> History:
        """A history that knows of that camera's view what another one's `state` was."""
        history = History()
        history._begin(camera, int(state["pattern"][0]))  # type: ignore[call-overload]
        for name in _OF_PIXELS:
            getattr(history, f"_{name}")[:] = state[name]
        return history

    def taken(self, camera: Camera, pixels: NDArray[np.uint32], seed: int) -> tuple[NDArray[np.int64], int]:
        """How many samples of (D,) pixels came from this camera, and the seed of the first of them.

        With the tracer's help, further samples go where those left gaps.
        """
        if self._camera is None or self._camera.key != camera.key:
            return np.zeros(len(pixels), dtype=np.int64), seed
        return self._count[pixels].astype(np.int64), self._pattern

    def unseen(self, camera: Camera, pixels: NDArray[np.uint32], places: int) -> NDArray[np.uint32]:
        """Those of some pixels that want better auxiliary features: means over fewer places than these, or than there are
        samples, up to as many as anyone sees."""
        if self._camera is None or self._camera.key != camera.key:
            return pixels
        wanted = np.clip(self._count[pixels], places, _MOST_PLACES)
        return pixels[self._places[pixels] < wanted]

    def recall(
        self, camera: Camera, pixels: NDArray[np.uint32], seen: Samples, places: int, seed: int
    ) -> Samples:
        """What is remembered of pixels.

        Args:
            camera: the view.
            pixels: (D,) row-major indices.
            seen: those of them that were looked at anew, with their auxiliary features, without light; all, if nothing
                was seen from this camera before.
            places: of which these auxiliary features are means.
            seed: of the samples that are to come.
        """
        if self._camera is None or (self._camera.width, self._camera.height) != (camera.width, camera.height):
            self._views.clear()
            self._past = None
            self._begin(camera, seed)
        elif self._camera.key != camera.key:
            self._views.append(self._seen_from_here(self._camera))
            self._past = reproject(self._views, camera, seen)
            self._begin(camera, seed)
        self._look(seen, places)
        auxiliary = self._auxiliary[pixels] / self._places[pixels][:, None]
        count, light = self._count[pixels], self._light[pixels]
        if self._past is not None:
            index = pixels.astype(np.int64)
            more, past = self._past.at(index // camera.width, index % camera.width)
            count, light = count + more, light + past
        light = light / np.maximum(count, np.float32(1e-6))[:, None]
        parts = light[:, 0:3], light[:, 3:6], auxiliary[:, 0:3], auxiliary[:, 3:6]
        return Samples(pixels, count, *parts, self._position[pixels], self._gloss[pixels])

    def _look(self, seen: Samples, places: int) -> None:
        """Adds auxiliary features, which are traced anew for each camera: none that were carried along are as good."""
        pixels = seen.pixels
        first = self._places[pixels] == 0
        self._position[pixels[first]], self._gloss[pixels[first]] = seen.position[first], seen.gloss[first]
        self._auxiliary[pixels] += np.hstack([seen.albedo, seen.normal]) * places
        self._places[pixels] += places

    def remember(self, new: Samples) -> None:
        """Adds samples of the view that was recalled last."""
        pixels = new.pixels
        self._light[pixels] += np.hstack([new.radiance, new.squares]) * new.count[:, None]
        self._count[pixels] += new.count

    def _begin(self, camera: Camera, seed: int) -> None:
        """Nothing has been traced from this camera yet."""
        size = camera.width * camera.height
        self._camera, self._pattern = camera, seed
        self._count = np.zeros(size, dtype=np.float32)
        self._light = np.zeros((size, 6), dtype=np.float32)
        self._places = np.zeros(size, dtype=np.float32)
        self._auxiliary = np.zeros((size, 6), dtype=np.float32)
        self._position = np.zeros((size, 3), dtype=np.float32)
        self._gloss = np.zeros(size, dtype=np.uint8)

    def _seen_from_here(self, camera: Camera) -> EarlierView:
        """All that was traced from this camera."""
        pixels = np.flatnonzero(self._count)
        count = self._count[pixels]
        return EarlierView(
            np.minimum(count, _MOST_SAMPLES),
            self._light[pixels] / count[:, None],
            self._position[pixels],
            self._gloss[pixels],
            camera.position,
        )
