"""The server's end of a streamed disc: path-traced for the newest view, and refined while that stays."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.fovea.foveation import FoveaRegion
from compose.image.device_image import srgb_bytes
from hybrid.render.frame import Frame
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from hybrid.window.remote.disc_messages import MOST_PIXELS, DiscMessage, DiscWanted, content_of, square_of
from hybrid.window.remote.protocol import ViewMessage
from hybrid.window.window_views import nearness
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Samples per pixel that are added at once while the view stays, and from which on it is good enough.
_MORE, _ENOUGH = 8, 64
# Paths of one disc: those of a quarter of a second on two cores.
_MOST_PATHS = 1 << 18


class DiscServer:
    """Traces the disc of one client's views.

    Args:
        scene, forest: the scene, and the forest whose splats lie under the disc.
        acuity_model: of these splats.
    """

    def __init__(self, scene: Scene, forest: Forest, acuity_model: str):
        self._renderer = LiveRenderer(scene, forest)
        self._settings = replace(INTERACTIVE, acuity_model=acuity_model)
        self._seed = 0
        # What the last frame was made for.
        self._last: tuple[FrameSettings, Frame] | None = None

    def forget(self) -> None:
        """Begins with another client."""
        self._renderer.forget()
        self._last = None

    def message(self, view: ViewMessage, wanted: DiscWanted) -> DiscMessage:
        """The disc of a view, with more samples if the last one was for the same."""
        settings = _affordable(
            replace(
                self._settings,
                gaze=view.gaze,
                fov_a=wanted.fov_a,
                fov_b=wanted.fov_b,
                spp=wanted.spp,
                display=view.display,
                camera=view.camera,
            )
        )
        self._seed += 1
        if self._last is not None and settings == self._last[0]:
            frame = self._renderer.refined(self._last[1], max(_MORE, settings.spp), self._seed, quick=False)
        else:
            frame = self._renderer.frame(settings, self._seed)
        self._last = settings, frame
        region = frame.region
        if not isinstance(region, FoveaRegion) or not region.count:
            return DiscMessage(view.sequence)
        spp = frame.fovea.samples.mean_count()
        side = 2 * int(np.ceil(region.outer)) + 2
        left, top = (int(np.floor(at)) - side // 2 for at in region.centre)
        final = spp >= _ENOUGH
        where = DiscMessage(view.sequence, left, top, side, settings.fov_a, settings.fov_b, spp, final)
        near = np.asarray(nearness(square_of(frame.camera, where), self._renderer.tracer))
        return replace(where, **content_of(_image(frame, where), near, final))


def _affordable(settings: FrameSettings) -> FrameSettings:
    """With fewer samples, then a smaller radius, where a disc would be more than it may."""
    assert settings.camera is not None
    height = settings.camera.height
    most = 100 * (np.sqrt(MOST_PIXELS) / 2 - 2) / height
    if settings.fov_a > most:
        settings = settings.with_radius(float(most))
    pixels = max(1.0, np.pi * (settings.fov_a / 100 * height) ** 2)
    return replace(settings, spp=max(1, min(settings.spp, int(_MOST_PATHS / pixels))))


def _image(frame: Frame, where: DiscMessage) -> NDArray[np.uint8]:
    """(side, side, 3) sRGB: what was traced in the disc, splats around it; beyond the frame its border."""
    arrays, disc = frame.image.arrays, frame.fovea.disc
    plain = arrays.plain
    traced = frame.image.packed().changed(disc.pixels, frame.fovea.radiance)
    row, column = arrays.rows_columns(dr.arange(plain.UInt, where.side**2), where.side)
    numbers = [where.top, where.left, frame.camera.height - 1, frame.camera.width - 1]
    top, left, *last = arrays.scalars(plain.Int, numbers)
    at = (plain.Int(row) + top, plain.Int(column) + left)
    pixels = traced.at(*(plain.UInt(dr.clip(one, 0, most)) for one, most in zip(at, last, strict=True)))
    flat = plain.Float(dr.ravel(plain.Array3f(*pixels)))
    return srgb_bytes(arrays, flat, (where.side, where.side, 3))
