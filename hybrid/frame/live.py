"""Frames for a window: rendered quickly at first and then, while nothing changes, improved."""

from __future__ import annotations

from dataclasses import replace

from compose.blend.blend import blend
from compose.camera.camera import Camera
from compose.eye.detail import DetailMap
from compose.fovea.mode import FoveaMode
from compose.fovea.region import FoveaRegion
from hybrid.frame.fill import MOVING, Fill
from hybrid.frame.frame import Frame
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import INTERACTIVE, FrameSettings
from hybrid.runtime.clock import Clock
from pathtrace.scene.scene import Scene
from splat.lod.image import SplatImage
from splat.model.forest import Forest

# Ending paths early saves more time than it adds noise, and every frame adds samples: on `room` it takes
# 25 ms instead of 53 at 1.5 times the variance; on staircase2 time and variance change by the same factor.
_ROULETTE_DEPTH = 1


class LiveRenderer(Renderer):
    """Renders frames in sequence, with a fovea that reuses the samples of earlier frames.

    Args:
        scene: what is path-traced.
        forest: its Gaussians.

    Raises:
        UserError: the forest belongs to another scene.
    """

    _is_quick, _effort = True, MOVING

    def __init__(self, scene: Scene, forest: Forest):
        super().__init__(scene, forest, history=True, roulette_depth=_ROULETTE_DEPTH)
        # Camera and time; and whether the frame that is made shows what the last one showed.
        self._last_view: tuple[Camera, float] | None = None
        self._still = False

    def frame(self, settings: FrameSettings = INTERACTIVE, seed: int = 0) -> Frame:
        """One frame, as from `Renderer.frame`; what depends on the camera alone is kept until it moves."""
        return super().frame(settings, seed)

    def _drawn(
        self, camera: Camera, settings: FrameSettings, region: FoveaRegion, clock: Clock
    ) -> tuple[DetailMap, SplatImage, SplatImage | None]:
        view = camera, settings.time
        self._still, self._last_view = view == self._last_view, view
        if not self._still:
            return super()._drawn(camera, settings, region, clock)
        detail = self.periphery.detail(camera, settings)
        clock.lap("detail")
        drawn = self.periphery.draw_still(camera, settings, detail, region)
        if settings.fovea is not FoveaMode.FUSED:
            return detail, drawn, None
        return detail, drawn, self.periphery.whole_still(camera, settings, detail)

    def _fill(self, camera: Camera, settings: FrameSettings, seed: int) -> Fill | None:
        """As of `Renderer`: quickly while the camera moves, and once when it stands still."""
        integrator = settings.used_integrator
        # Until all light is renewed, what was traced before is old.
        if settings.fill and self._still and self.light_renewed == 1:
            return self._filler.kept(
                camera, self.tracer, lambda: self.tracer_of(integrator), integrator, seed
            )
        return super()._fill(camera, settings, seed)

    def refined(self, frame: Frame, spp: int, seed: int, quick: bool) -> Frame:
        """A frame with further samples in its disc.

        Args:
            frame: the last one of this renderer.
            spp: samples per pixel to add.
            seed: of these samples.
            quick: whether the fovea is made with the quicker denoiser.
        """
        clock, settings = Clock(), replace(frame.settings, spp=spp)
        self._relight(settings)
        shown = frame.fovea.disc, seed, frame.splats, frame.underlay
        fovea = self._fovea(settings, frame.camera, *shown, clock, quick)
        composite = blend(frame.splats, fovea.radiance, fovea.disc)
        clock.lap("blend")
        return replace(frame, image=composite, fovea=fovea, milliseconds=clock.milliseconds())

    def forget(self) -> None:
        """Drops everything that is known from earlier frames."""
        super().forget()
        self._last_view = None
