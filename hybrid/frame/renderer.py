"""The hybrid frame: path-traced disc, splatted periphery, blended."""

from __future__ import annotations

import numpy as np

from compose.blend.blend import blend
from compose.camera.camera import Camera
from compose.fovea.band import thinned
from compose.fovea.region import FoveaRegion, Foveation
from compose.fovea.samples import Samples
from compose.image.colour import Image
from hybrid.frame.disc import Underlay
from hybrid.frame.fovea import Fovea
from hybrid.frame.frame import Frame
from hybrid.frame.fusion import fusion_of
from hybrid.frame.periphery import Periphery, Viewing
from hybrid.frame.traced_image import traced_image
from hybrid.runtime.clock import Clock
from hybrid.runtime.device import device_arrays
from hybrid.store.identity import require_scene
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import FilmPositions
from pathtrace.trace.tracer import RUSSIAN_ROULETTE_DEPTH, Tracer
from splat.model.forest import Forest


class HybridRenderer:
    """Renders hybrid frames of one scene with one forest.

    Args:
        scene: what is path-traced.
        forest: its Gaussians.
        viewing: who looks, on what display.
        mode: how the fovea is made: raw, denoised or fused.
        remembers: whether the fovea keeps the samples of earlier frames.
        roulette_depth: as of the tracer.

    Raises:
        UserError: the forest is one of another scene, or there is no such mode.
    """

    def __init__(
        self,
        scene: Scene,
        forest: Forest,
        viewing: Viewing | None = None,
        mode: str = "raw",
        remembers: bool = False,
        roulette_depth: int = RUSSIAN_ROULETTE_DEPTH,
    ):
        require_scene(forest, scene.name, scene.hash, "this forest")
        self.tracer = Tracer(scene, roulette_depth=roulette_depth)
        self.periphery = Periphery(device_arrays(), forest, viewing or Viewing())
        self.fovea = Fovea(self.tracer, mode, fusion_of(forest), remembers)

    def frame(self, camera: Camera, foveation: Foveation, spp: int = 1, seed: int = 0) -> Frame:
        """One frame.

        Args:
            camera: the view.
            foveation: gaze and radii.
            spp: samples per pixel in the disc.
            seed: same seed, same frame.
        """
        clock = Clock()
        region = foveation.region(camera.width, camera.height)
        clock.lap("plan")
        detail = self.periphery.detail(camera, foveation.gaze, foveation.fov_b)
        clock.lap("detail")
        drawn = self.periphery.draw(camera, detail, region)
        periphery = drawn.image()
        clock.lap("splat")
        underlay = self.underlay(camera, region)
        clock.lap("under")
        region, samples = self._traced(camera, region, spp, seed, underlay)
        clock.lap("trace")
        fovea = self.fovea.picture(camera, region, samples, periphery, underlay)
        clock.lap("fovea")
        composite = blend(periphery, fovea.radiance, region)
        clock.lap("blend")
        return Frame(composite, periphery, fovea, underlay, region, detail, drawn.nodes, clock.milliseconds())

    def underlay(self, camera: Camera, region: FoveaRegion) -> Underlay | None:
        """The splats under the disc, where they are fused with it."""
        if self.fovea.mode != "fused":
            return None
        radiance = self.periphery.under_fovea(camera, region).image()
        return Underlay(camera, radiance, self.periphery.enlargement(camera))

    def _traced(
        self, camera: Camera, region: FoveaRegion, spp: int, seed: int, underlay: Underlay | None
    ) -> tuple[FoveaRegion, Samples]:
        """The disc's samples, and the plan of the pixels that have any."""
        if not self.fovea.is_independent:
            return region, self.fovea.disc.trace(camera, region, spp, seed, underlay)
        region, counts = thinned(region, spp, seed)
        return region, self.fovea.disc.trace_each(camera, region.pixels, counts, seed)

    def disc_alone(self, camera: Camera, region: FoveaRegion, spp: int, seed: int) -> Image:
        """(D, 3) the disc as a frame shows it, without the splats around it; D as in that frame's plan."""
        underlay = self.underlay(camera, region)
        region, samples = self._traced(camera, region, spp, seed, underlay)
        around = np.zeros((region.height, region.width, 3), dtype=np.float32)
        return self.fovea.picture(camera, region, samples, around, underlay).radiance

    def splat_frame(self, camera: Camera) -> Image:
        """(H, W, 3) the finest layer over the whole frame, also where a fovea would hide it."""
        return self.periphery.whole(camera)

    def path_traced(self, camera: Camera, positions: FilmPositions, spp: int, seed: int) -> Image:
        """(H, W, 3) the whole frame without splats, denoised unless the fovea is raw."""
        denoised = self.fovea.mode != "raw"
        return traced_image(self.tracer, camera, positions, camera.width, spp, seed, denoised)
