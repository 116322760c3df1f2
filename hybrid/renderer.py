"""The hybrid frame: path-traced disc, splatted periphery, blended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.blend import Image, blend
from compose.detail import DetailMap
from compose.foveation import FoveaPlan, Foveation
from compose.samples import Samples
from compose.thinning import thinned
from compose.view import Camera
from hybrid.device import device_arrays
from hybrid.disc import Underlay
from hybrid.fovea import Fovea, FoveaPicture
from hybrid.fusing import fusion_of
from hybrid.identity import require_scene
from hybrid.periphery import Periphery, Viewing
from hybrid.timing import Clock
from hybrid.traced_image import traced_image
from pathtrace.film import FilmPositions
from pathtrace.scene import Scene
from pathtrace.tracer import RUSSIAN_ROULETTE_DEPTH, Tracer
from splat.forest import Forest


@dataclass(frozen=True)
class Frame:
    """One frame and its parts.

    Attributes:
        composite: (H, W, 3) linear radiance, what the viewer sees.
        periphery: (H, W, 3) the splats; black in tiles that the fovea hides.
        detail: what the viewer resolves where.
        nodes_drawn: Gaussians in the periphery, those of several pictures counted in each.
        fovea: the disc and what it was made of.
        under: the splats under the disc, of a fused one.
        plan: which pixels that is, and the weights of the blend; of a raw fovea, those that have samples.
        milliseconds: per pass (plan, detail, splat, under, trace, fovea, blend) and in all (total).
    """

    composite: Image
    periphery: Image
    fovea: FoveaPicture
    under: Underlay | None
    plan: FoveaPlan
    detail: DetailMap
    nodes_drawn: int
    milliseconds: dict[str, float]

    def of_disc(self, values: NDArray[np.float32]) -> Image:
        """(H, W, C) an image of the plan's pixels' values (D, C), black elsewhere."""
        image = np.zeros((self.plan.height * self.plan.width, values.shape[1]), dtype=np.float32)
        image[self.plan.pixels] = values
        return image.reshape(self.plan.height, self.plan.width, -1)


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
        plan = foveation.plan(camera.width, camera.height)
        clock.lap("plan")
        detail = self.periphery.detail(camera, foveation.gaze, foveation.fov_b)
        clock.lap("detail")
        drawn = self.periphery.draw(camera, detail, plan)
        periphery = drawn.image()
        clock.lap("splat")
        under = self.underlay(camera, plan)
        clock.lap("under")
        plan, samples = self._traced(camera, plan, spp, seed, under)
        clock.lap("trace")
        fovea = self.fovea.picture(camera, plan, samples, periphery, under)
        clock.lap("fovea")
        composite = blend(periphery, fovea.radiance, plan)
        clock.lap("blend")
        return Frame(composite, periphery, fovea, under, plan, detail, drawn.nodes, clock.milliseconds())

    def underlay(self, camera: Camera, plan: FoveaPlan) -> Underlay | None:
        """The splats under the disc, where they are fused with it."""
        if self.fovea.mode != "fused":
            return None
        radiance = self.periphery.under_fovea(camera, plan).image()
        return Underlay(camera, radiance, self.periphery.enlargement(camera))

    def _traced(
        self, camera: Camera, plan: FoveaPlan, spp: int, seed: int, under: Underlay | None
    ) -> tuple[FoveaPlan, Samples]:
        """The disc's samples, and the plan of the pixels that have any."""
        if not self.fovea.is_independent:
            return plan, self.fovea.disc.trace(camera, plan, spp, seed, under)
        plan, counts = thinned(plan, spp, seed)
        return plan, self.fovea.disc.trace_each(camera, plan.pixels, counts, seed)

    def disc_alone(self, camera: Camera, plan: FoveaPlan, spp: int, seed: int) -> Image:
        """(D, 3) the disc as a frame shows it, without the splats around it; D as in that frame's plan."""
        under = self.underlay(camera, plan)
        plan, samples = self._traced(camera, plan, spp, seed, under)
        around = np.zeros((plan.height, plan.width, 3), dtype=np.float32)
        return self.fovea.picture(camera, plan, samples, around, under).radiance

    def splat_frame(self, camera: Camera) -> Image:
        """(H, W, 3) the finest layer over the whole frame, also where a fovea would hide it."""
        return self.periphery.whole(camera)

    def path_traced(self, camera: Camera, positions: FilmPositions, spp: int, seed: int) -> Image:
        """(H, W, 3) the whole frame without splats, denoised unless the fovea is raw."""
        denoised = self.fovea.mode != "raw"
        return traced_image(self.tracer, camera, positions, camera.width, spp, seed, denoised)
