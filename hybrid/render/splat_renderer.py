"""Frames of a forest alone, with the detail that the viewer resolves: all there is without a scene."""

from __future__ import annotations

from dataclasses import replace

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.fovea.disc import Disc
from compose.fovea.samples import Samples
from compose.image.colour import Image
from hybrid.base.compute_device import PassClock, device_arrays
from hybrid.render.fovea import FoveaImage
from hybrid.render.frame import Frame
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.periphery import Periphery
from splat.model.forest import Forest
from splat.model.points import Bits


class SplatRenderer:
    """Renders frames of a forest without its scene.

    Args:
        forest: what to draw.

    Examples:
        >>> frames = hybrid.load_frames("lego")
        >>> renderer = hybrid.SplatRenderer(hybrid.load_forest("lego.forest"))
        >>> view = frames.held_out[0]
        >>> renderer.frame(hybrid.FrameSettings(camera=view.camera, time=view.time)).save("0.png")
    """

    def __init__(self, forest: Forest):
        self.forest, self._arrays = forest, device_arrays()
        self._periphery = Periphery(self._arrays, forest)

    def hold_cut(self, drawn: Bits) -> None:
        """Draws these nodes (N + M,) of the forest's hierarchy wherever levels are continuous."""
        self._periphery.hold_cut(drawn)

    def frame(self, settings: FrameSettings) -> Frame:
        """Renders one frame, of whose disc no pixel is traced.

        Args:
            settings: gaze, display, acuity model, layers, rate, scale and time; those of a disc are ignored.

        Raises:
            UserError: the settings have no camera, or ask for layers that the forest does not have or for
                depth, which requires a scene.
        """
        if "depth" in settings.aovs:
            raise UserError("aovs depth: a forest alone has none; it takes a scene")
        clock = PassClock()
        camera, settings = self._begun(settings)
        region = settings.foveation.region(camera.width, camera.height)
        detail = self._periphery.detail(camera, settings)
        clock.lap("detail")
        image = self._periphery.draw(camera, detail, region)
        clock.lap("splat")
        disc = Disc.in_region(self._arrays, region)
        nothing = Samples.none(self._arrays, disc.pixels)
        return Frame(
            image=image,
            settings=settings,
            camera=camera,
            behind=nothing.radiance,
            detail=detail,
            nodes_drawn=image.nodes,
            fovea=FoveaImage(disc, nothing.radiance, nothing),
            region=region,
            milliseconds=clock.milliseconds(),
            more={"splat": self._periphery.whole(camera, settings).numpy()} if settings.aovs else {},
        )

    def splats(self, settings: FrameSettings) -> Image:
        """(H, W, 3) the finest allowed layer over the whole frame at full rate; UserError as in `frame`."""
        return self._periphery.whole(*self._begun(settings)).numpy()

    def _begun(self, settings: FrameSettings) -> tuple[Camera, FrameSettings]:
        """The camera, and the settings without a disc; the forest shows their time from now on."""
        if settings.camera is None:
            raise UserError("camera: a forest alone has none; give one in the settings")
        camera, settings = replace(settings, fov_a=0.0, fov_b=0.0).resolved(settings.camera)
        self._periphery.set_time(settings.time)
        return camera, settings
