"""Frames for a window: rendered quickly at first and then, while nothing changes, improved."""

from __future__ import annotations

from dataclasses import replace

from compose.base.seeds import require_seed
from compose.blend.blend import blend
from compose.camera.camera import Camera
from compose.eye.detail import DetailMap
from hybrid.frame.fill import MOVING, Fill
from hybrid.frame.fovea import FoveaImage
from hybrid.frame.frame import Frame
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import INTERACTIVE, FrameSettings
from hybrid.frame.underlay import Underlay
from hybrid.runtime.clock import Clock
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Ending paths early saves more time than it adds noise, and every frame adds samples: on `room` it takes
# 25 ms instead of 53 at 1.5 times the variance; on staircase2 time and variance change by the same factor.
_ROULETTE_DEPTH = 1


class LiveRenderer(Renderer):
    """Renders frames in sequence, with a raw or a fused fovea that reuses the samples of earlier frames.

    Args:
        scene: what is path-traced.
        forest: its Gaussians.

    Raises:
        UserError: the forest belongs to another scene.
    """

    def __init__(self, scene: Scene, forest: Forest):
        super().__init__(scene, forest, history=True, roulette_depth=_ROULETTE_DEPTH)
        # Camera and time.
        self._last_view: tuple[Camera, float] | None = None

    def frame(self, settings: FrameSettings = INTERACTIVE, seed: int = 0) -> Frame:
        """One frame, as from `Renderer.frame`; what depends on the camera alone is kept until it moves."""
        seed = require_seed(seed)
        maker, clock = self.fovea_of(settings), Clock()
        camera, settings = self._begun(settings)
        disc = settings.foveation.region(camera.width, camera.height)
        still, self._last_view = (camera, settings.time) == self._last_view, (camera, settings.time)
        detail = self.periphery.detail(camera, settings, moving=not still)
        clock.lap("region")
        self._relight(settings)
        fill = self._fill_now(camera, settings, seed, still)
        clock.lap("fill")
        if still:
            underlay: Underlay | None = self._still_underlay(camera, settings, detail, fill)
        else:
            underlay = self.underlay(camera, settings, disc, fill)
        clock.lap("underlay")
        region, samples = maker.trace(settings.fovea, camera, disc, settings.spp, seed, underlay, quick=True)
        clock.lap("trace")
        fovea = maker.image(settings.fovea, region, samples, None, underlay, quick=True)
        clock.lap("fovea")
        if still:
            drawn = self.periphery.draw_still(camera, settings, detail, disc)
        else:
            drawn = self.periphery.draw(camera, detail, disc)
        periphery = drawn.image() if fill is None else fill.over(drawn.image())
        clock.lap("splat")
        composite = blend(periphery, fovea.radiance, region)
        clock.lap("blend")
        parts = periphery, detail, drawn.nodes, fovea, underlay, region, clock.milliseconds()
        return Frame(composite, settings, camera, *parts, self, fill)

    def _fill_now(self, camera: Camera, settings: FrameSettings, seed: int, still: bool) -> Fill | None:
        """As `_fill`: quickly while the camera moves, and once when it stands still."""
        if not settings.fill:
            return None
        integrator = settings.used_integrator
        # Until all light is renewed, what was traced before is old.
        if still and self.light_renewed == 1:
            return self._filler.kept(
                camera, self.tracer, lambda: self.tracer_of(integrator), integrator, seed
            )
        return self._filler.fill(camera, self.tracer, lambda: self.tracer_of(integrator), MOVING, seed)

    def refined(self, frame: Frame, spp: int, seed: int, quick: bool) -> Frame:
        """A frame with further samples in its disc.

        Args:
            frame: the last one of this renderer.
            spp: samples per pixel to add.
            seed: of these samples.
            quick: whether the fovea is made with the quicker denoiser.
        """
        clock = Clock()
        fovea = self._refined_fovea(frame, spp, seed, quick, clock)
        composite = blend(frame.periphery, fovea.radiance, frame.region)
        clock.lap("blend")
        return replace(frame, composite=composite, fovea=fovea, milliseconds=clock.milliseconds())

    def _refined_fovea(self, frame: Frame, spp: int, seed: int, quick: bool, clock: Clock) -> FoveaImage:
        mode, region, maker = frame.settings.fovea, frame.region, self.fovea_of(frame.settings)
        self._relight(frame.settings)
        region, samples = maker.trace(mode, frame.camera, region, spp, seed, frame.underlay, quick=True)
        clock.lap("trace")
        fovea = maker.image(mode, region, samples, None, frame.underlay, quick)
        clock.lap("fovea")
        return fovea

    def _still_underlay(
        self, camera: Camera, settings: FrameSettings, detail: DetailMap, fill: Fill | None
    ) -> Underlay:
        radiance = self.periphery.whole_still(camera, settings, detail)
        radiance = radiance if fill is None else fill.over(radiance)
        return Underlay(camera, radiance, self.periphery.enlargement(camera, settings))

    def forget(self) -> None:
        """Drops everything that is known from earlier frames."""
        super().forget()
        self._last_view = None
