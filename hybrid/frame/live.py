"""Frames for a window: made for speed first and then, while nothing changes, for quality."""

from __future__ import annotations

from dataclasses import replace

from compose.blend.blend import blend
from compose.camera.camera import Camera
from compose.eye.detail import DetailMap
from compose.fovea.region import FoveaRegion, Foveation
from hybrid.frame.disc import Underlay
from hybrid.frame.fovea import FoveaPicture
from hybrid.frame.frame import Frame
from hybrid.frame.periphery import Viewing
from hybrid.frame.renderer import HybridRenderer
from hybrid.runtime.clock import Clock
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Ending paths early makes samples cheaper by more than it makes them noisier, and here every frame adds more
# of them: on `room` 25 ms in place of 53 for half as much variance again, on staircase2 as much of the one as
# of the other.
_ROULETTE_DEPTH = 1


class LiveRenderer(HybridRenderer):
    """Renders frames one after another, with a fused fovea that remembers the samples of earlier ones.

    Args:
        scene: what is path-traced.
        forest: its Gaussians.
        viewing: who looks, on what display.

    Raises:
        UserError: the forest is one of another scene.
    """

    def __init__(self, scene: Scene, forest: Forest, viewing: Viewing):
        super().__init__(scene, forest, viewing, "fused", remembers=True, roulette_depth=_ROULETTE_DEPTH)
        self._before: bytes | None = None

    def frame(self, camera: Camera, foveation: Foveation, spp: int = 1, seed: int = 0) -> Frame:
        """One frame: as that of a `HybridRenderer`; what a camera that stands still allows is kept."""
        clock = Clock()
        region = foveation.region(camera.width, camera.height)
        detail = self.periphery.detail(camera, foveation.gaze, foveation.fov_b)
        clock.lap("plan")
        still, self._before = camera.key == self._before, camera.key
        underlay = self._still_underlay(camera, detail) if still else self.underlay(camera, region)
        clock.lap("under")
        fovea = self._seen(camera, region, underlay, spp, seed, True, clock)
        draw = self.periphery.draw_still if still else self.periphery.draw
        drawn = draw(camera, detail, region)
        periphery = drawn.image()
        clock.lap("splat")
        composite = blend(periphery, fovea.radiance, region)
        clock.lap("blend")
        return Frame(composite, periphery, fovea, underlay, region, detail, drawn.nodes, clock.milliseconds())

    def refined(self, camera: Camera, frame: Frame, spp: int, seed: int, quick: bool) -> Frame:
        """The same frame with further samples in the disc.

        Args:
            camera: of the frame.
            frame: the last one, of this camera.
            spp, seed: of the samples that are added.
            hurried: whether the fovea is made of them in the quicker way.
        """
        clock = Clock()
        fovea = self._seen(camera, frame.region, frame.underlay, spp, seed, quick, clock)
        composite = blend(frame.periphery, fovea.radiance, frame.region)
        clock.lap("blend")
        return replace(frame, composite=composite, fovea=fovea, milliseconds=clock.milliseconds())

    def _still_underlay(self, camera: Camera, detail: DetailMap) -> Underlay:
        radiance = self.periphery.whole_still(camera, detail)
        return Underlay(camera, radiance, self.periphery.enlargement(camera))

    def _seen(
        self,
        camera: Camera,
        region: FoveaRegion,
        underlay: Underlay | None,
        spp: int,
        seed: int,
        quick: bool,
        clock: Clock,
    ) -> FoveaPicture:
        """The disc with so many more samples everywhere."""
        samples = self.fovea.disc.trace(camera, region, spp, seed, underlay, quick=True)
        clock.lap("trace")
        fovea = self.fovea.picture(camera, region, samples, None, underlay, quick)
        clock.lap("fovea")
        return fovea

    def forget(self) -> None:
        """From now on as if nothing had been seen before."""
        self.fovea.disc.forget()
        self._before = None
