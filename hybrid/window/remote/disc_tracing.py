"""The server's end of a streamed disc: path-traced for the newest view, and refined while that stays."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from compose.eye.gaze import Gaze
from compose.image.device_image import srgb_bytes
from hybrid.base.compute_device import SpareMemory
from hybrid.render.frame import Frame
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.remote.disc_messages import MOST_PIXELS, DiscMessage, DiscWanted, content_of
from hybrid.window.remote.protocol import View, ViewMessage
from hybrid.window.window_views import nearness
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Samples per pixel that are enough.
_ENOUGH = 64
# Growth of the time per path from one disc to the next, if it has grown.
_SLOWER = 1.1
# Pixels: a smaller disc has none.
_LEAST_RADIUS = 2.0
# Paths of one disc; and seconds that one may take for which others wait.
_MOST_PATHS, _MOST_SECONDS = 1 << 19, 0.15


@dataclass(frozen=True)
class _Traced:
    """What a disc was traced for, where it lies, and the frame of the square around it.

    `samples` are those per pixel that are known by now, and `due` those from which the next frame is made.
    """

    asked: tuple[View, DiscWanted]
    where: DiscMessage
    frame: Frame
    samples: float
    due: float


class DiscServer:
    """Traces the disc of one client's views.

    Args:
        scene, forest: the scene, and the forest whose splats lie under the disc.
        acuity_model: of these splats.
    """

    def __init__(self, scene: Scene, forest: Forest, acuity_model: str):
        self._renderer = LiveRenderer(scene, forest)
        self._settings = replace(INTERACTIVE, acuity_model=acuity_model)
        self._seed, self._memory = 0, SpareMemory()
        # Seconds per path; 0 before the first disc.
        self._pace = 0.0
        self._last: _Traced | None = None

    def forget(self) -> None:
        """Begins with another client."""
        self._renderer.forget()
        self._last = None

    def message(self, view: ViewMessage, wanted: DiscWanted, others_wait: bool = False) -> DiscMessage | None:
        """One step towards the disc of a view, or towards a better one if the last one was for the same.

        The first one is made quickly, the next one at leisure, and each one after that of twice the samples.
        None while they are traced, one per pixel in each call, so that whatever is new waits for one of them
        at most.

        If others wait for the thread, the disc is no larger than what is traced in a seventh of a second.
        """
        self._memory.release()
        self._seed += 1
        last = self._last
        if last is None or last.asked != (view.view, wanted):
            last = self._begun(view, wanted, others_wait)
            if last is None:
                return DiscMessage(view.sequence)
            final = False
        elif last.samples + 1 < min(last.due, _ENOUGH):
            samples = self._renderer.add_samples(last.frame, 1, self._seed)
            self._last = replace(last, samples=samples.mean_count())
            return None
        else:
            frame = self._renderer.refined(last.frame, 1, self._seed, quick=False)
            count = frame.fovea.samples.mean_count()
            last, final = replace(last, frame=frame, samples=count, due=2 * count), count >= _ENOUGH
        self._last, frame, where = last, last.frame, last.where
        # Without the blend, which is made with the client's own splats.
        image = frame.image.packed().changed(frame.fovea.disc.pixels, frame.fovea.radiance)
        pixels = srgb_bytes(image.arrays, image.values, (where.side, where.side, 3))
        near = np.asarray(nearness(frame.camera, self._renderer.tracer))
        where = replace(where, sequence=view.sequence, spp=last.samples, final=final)
        return replace(where, **content_of(pixels, near, final))

    def _begun(self, view: ViewMessage, wanted: DiscWanted, others_wait: bool) -> _Traced | None:
        """A new disc, smaller if others wait and paths take long; None if there is none to see."""
        most = _MOST_PATHS
        if others_wait and self._pace:
            # Powers of two: frames of ever new sizes take longer.
            most = min(most, 1 << int(math.log2(max(1.0, _MOST_SECONDS / self._pace))))
        begin = time.monotonic()
        traced = self._traced(view, wanted, most)
        if traced is not None:
            # The first ones compile kernels; what was once possible is forgotten slowly.
            took = (time.monotonic() - begin) / (traced.frame.region.count * traced.frame.settings.spp)
            self._pace = min(took, _SLOWER * self._pace) if self._pace else took
        return traced

    def _traced(self, view: ViewMessage, wanted: DiscWanted, most: int) -> _Traced | None:
        """A disc of so many paths at most; None if there is none to see."""
        camera = view.camera
        radius = min(
            wanted.fov_a / 100 * camera.height, math.sqrt(MOST_PIXELS) / 2 - 2, math.sqrt(most / math.pi)
        )
        spp = max(1, min(wanted.spp, int(most / (math.pi * max(1.0, radius) ** 2))))
        side = 2 * math.ceil(radius) + 2
        x, y = view.gaze.pixel(camera.width, camera.height)
        left, top = math.floor(x) - side // 2, math.floor(y) - side // 2
        shows = -side < left < camera.width and -side < top < camera.height
        if radius < _LEAST_RADIUS or not shows:
            return None
        share, outer = wanted.fov_b / wanted.fov_a, 100 * radius / side
        # Nothing else of the frame is rendered.
        settings = replace(
            self._settings,
            gaze=Gaze((x - left) / side, (y - top) / side),
            fov_a=outer,
            fov_b=share * outer,
            spp=spp,
            display=view.display,
            camera=camera.cropped(left, top, side, side),
        )
        fov_a = 100 * radius / camera.height
        where = DiscMessage(view.sequence, left, top, side, fov_a, share * fov_a)
        frame = self._renderer.frame(settings, self._seed)
        count = frame.fovea.samples.mean_count()
        return _Traced((view.view, wanted), where, frame, count, count + 1)
