"""Frames for a window: made for speed first and then, while nothing changes, for quality."""

from __future__ import annotations

from dataclasses import replace

from compose.blend import blend
from compose.detail import DetailMap
from compose.foveation import FoveaPlan, Foveation
from compose.view import Camera
from hybrid.disc import Underlay
from hybrid.fovea import FoveaPicture
from hybrid.periphery import Viewing
from hybrid.renderer import Frame, HybridRenderer
from hybrid.timing import Clock
from pathtrace.scene import Scene
from splat.forest import Forest

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
        plan = foveation.plan(camera.width, camera.height)
        detail = self.periphery.detail(camera, foveation.gaze, foveation.fov_b)
        clock.lap("plan")
        still, self._before = camera.key == self._before, camera.key
        under = self._still_underlay(camera, detail) if still else self.underlay(camera, plan)
        clock.lap("under")
        fovea = self._seen(camera, plan, under, spp, seed, True, clock)
        draw = self.periphery.draw_still if still else self.periphery.draw
        drawn = draw(camera, detail, plan)
        periphery = drawn.image()
        clock.lap("splat")
        composite = blend(periphery, fovea.radiance, plan)
        clock.lap("blend")
        return Frame(composite, periphery, fovea, under, plan, detail, drawn.nodes, clock.milliseconds())

    def refined(self, camera: Camera, frame: Frame, spp: int, seed: int, hurried: bool) -> Frame:
        """The same frame with further samples in the disc.

        Args:
            camera: of the frame.
            frame: the last one, of this camera.
            spp, seed: of the samples that are added.
            hurried: whether the fovea is made of them in the quicker way.
        """
        clock = Clock()
        fovea = self._seen(camera, frame.plan, frame.under, spp, seed, hurried, clock)
        composite = blend(frame.periphery, fovea.radiance, frame.plan)
        clock.lap("blend")
        return replace(frame, composite=composite, fovea=fovea, milliseconds=clock.milliseconds())

    def _still_underlay(self, camera: Camera, detail: DetailMap) -> Underlay:
        radiance = self.periphery.whole_still(camera, detail)
        return Underlay(camera, radiance, self.periphery.enlargement(camera))

    def _seen(
        self,
        camera: Camera,
        plan: FoveaPlan,
        under: Underlay | None,
        spp: int,
        seed: int,
        hurried: bool,
        clock: Clock,
    ) -> FoveaPicture:
        """The disc with so many more samples everywhere."""
        samples = self.fovea.disc.trace(camera, plan, spp, seed, under, hurried=True)
        clock.lap("trace")
        fovea = self.fovea.picture(camera, plan, samples, None, under, hurried)
        clock.lap("fovea")
        return fovea

    def forget(self) -> None:
        """From now on as if nothing had been seen before."""
        self.fovea.disc.forget()
        self._before = None
