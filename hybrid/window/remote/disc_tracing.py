"""The server's end of a streamed disc: path-traced for the newest view, and refined while that stays."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np

from compose.eye.gaze import Gaze
from compose.image.device_image import srgb_bytes
from hybrid.base.compute_device import release_memory
from hybrid.render.frame import Frame
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from hybrid.window.remote.disc_messages import MOST_PIXELS, DiscMessage, DiscWanted, content_of
from hybrid.window.remote.protocol import ViewMessage
from hybrid.window.window_views import nearness
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Samples per pixel that are added at once while the view stays: masks wait for them. And so many are enough.
_MORE, _ENOUGH = 4, 64
# Growth of the time per path from one disc to the next, if it has grown.
_SLOWER = 1.1
# Seconds between two releases of unused memory, each of which takes milliseconds.
_RELEASE_EVERY = 2.0
# Pixels: a smaller disc has none.
_LEAST_RADIUS = 2.0
# Paths of one disc; and seconds that one may take for which others wait.
_MOST_PATHS, _MOST_SECONDS = 1 << 19, 0.15


class DiscServer:
    """Traces the disc of one client's views.

    Args:
        scene, forest: the scene, and the forest whose splats lie under the disc.
        acuity_model: of these splats.
    """

    def __init__(self, scene: Scene, forest: Forest, acuity_model: str):
        self._renderer = LiveRenderer(scene, forest)
        self._settings = replace(INTERACTIVE, acuity_model=acuity_model)
        self._seed, self._released = 0, time.monotonic()
        # Seconds per path; 0 before the first disc.
        self._pace = 0.0
        # What the last frame was made for.
        self._last: tuple[FrameSettings, Frame] | None = None

    def forget(self) -> None:
        """Begins with another client."""
        self._renderer.forget()
        self._last = None

    def message(self, view: ViewMessage, wanted: DiscWanted, others_wait: bool = False) -> DiscMessage:
        """The disc of a view, with more samples if the last one was for the same.

        If others wait for the thread, it is no larger than what is traced in a seventh of a second.
        """
        most = _MOST_PATHS
        if others_wait and self._pace:
            most = min(most, max(1, int(_MOST_SECONDS / self._pace)))
        radius, spp = _affordable(wanted, view.camera.height, most)
        begin = time.monotonic()
        side = 2 * math.ceil(radius) + 2
        x, y = view.gaze.pixel(view.camera.width, view.camera.height)
        left, top = math.floor(x) - side // 2, math.floor(y) - side // 2
        is_beside = (
            left + side <= 0 or top + side <= 0 or left >= view.camera.width or top >= view.camera.height
        )
        if radius < _LEAST_RADIUS or is_beside:
            return DiscMessage(view.sequence)
        # Nothing else of the frame is rendered.
        square = view.camera.cropped(left, top, side, side)
        outer, share = 100 * radius / side, wanted.fov_b / wanted.fov_a
        settings = replace(
            self._settings,
            gaze=Gaze((x - left) / side, (y - top) / side),
            fov_a=outer,
            fov_b=share * outer,
            spp=spp,
            display=view.display,
            camera=square,
        )
        self._seed += 1
        if time.monotonic() - self._released > _RELEASE_EVERY:
            # What discs of other sizes needed.
            release_memory()
            self._released = time.monotonic()
        if self._last is not None and settings == self._last[0]:
            spp = spp if others_wait else max(_MORE, spp)
            frame = self._renderer.refined(self._last[1], spp, self._seed, quick=False)
        else:
            frame = self._renderer.frame(settings, self._seed)
        self._last = settings, frame
        samples = frame.fovea.samples.mean_count()
        fov_a, final = 100 * radius / view.camera.height, samples >= _ENOUGH
        # Without the blend, which is made with the client's own splats.
        image = frame.image.packed().changed(frame.fovea.disc.pixels, frame.fovea.radiance)
        pixels = srgb_bytes(image.arrays, image.values, (side, side, 3))
        near = np.asarray(nearness(square, self._renderer.tracer))
        # The first ones compile kernels; what was once possible is forgotten slowly.
        took = (time.monotonic() - begin) / max(1, frame.region.count * spp)
        self._pace = min(took, _SLOWER * self._pace) if self._pace else took
        where = DiscMessage(view.sequence, left, top, side, fov_a, share * fov_a, samples, final)
        return replace(where, **content_of(pixels, near, final))


def _affordable(wanted: DiscWanted, height: int, most: int) -> tuple[float, int]:
    """Radius in pixels and samples per pixel of a disc of so many paths at most."""
    radius = min(wanted.fov_a / 100 * height, math.sqrt(MOST_PIXELS) / 2 - 2, math.sqrt(most / math.pi))
    return radius, max(1, min(wanted.spp, int(most / (math.pi * max(1.0, radius) ** 2))))
