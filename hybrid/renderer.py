"""The hybrid frame: path-traced disc, splatted periphery, blended."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.blend import Image, blend
from compose.detail import DetailMap
from compose.errors import UserError
from compose.foveation import FoveaPlan, Foveation
from compose.view import Camera
from hybrid.device import device_arrays
from hybrid.periphery import Periphery, Viewing
from pathtrace.denoise import denoise
from pathtrace.scene import Scene
from pathtrace.tracer import FilmPositions, Traced, Tracer, pixel_positions
from splat.forest import Forest


@dataclass(frozen=True)
class Frame:
    """One frame and its parts.

    Attributes:
        composite: (H, W, 3) linear radiance, what the viewer sees.
        periphery: (H, W, 3) the splats; black in tiles that the fovea hides.
        detail: what the viewer resolves where.
        nodes_drawn: Gaussians in the periphery, those of several pictures counted in each.
        fovea: (D, 3) path-traced radiance of the plan's pixels.
        plan: which pixels those are, and the weights.
        milliseconds: per pass (plan, detail, splat, trace, denoise, blend) and in all (total).
    """

    composite: Image
    periphery: Image
    fovea: NDArray[np.float32]
    plan: FoveaPlan
    detail: DetailMap
    nodes_drawn: int
    milliseconds: dict[str, float]

    def fovea_image(self) -> Image:
        """(H, W, 3) the path-traced radiance where there is any, else black."""
        image = np.zeros_like(self.composite)
        image.reshape(-1, 3)[self.plan.pixels] = self.fovea
        return image


class HybridRenderer:
    """Renders hybrid frames of one scene with one forest.

    Args:
        scene: what is path-traced.
        forest: its Gaussians.
        viewing: who looks, on what display.
        denoised: whether the disc is denoised before it is blended.

    Raises:
        UserError: the forest is one of another scene.
    """

    def __init__(self, scene: Scene, forest: Forest, viewing: Viewing | None = None, denoised: bool = False):
        # An imported forest is bound to no scene.
        if forest.scene_hash not in ("", scene.hash):
            raise UserError(
                f"this forest is one of scene {forest.scene_name} "
                f"({forest.scene_hash[:8]}), not of {scene.name} ({scene.hash[:8]}); train one for this scene"
            )
        self.tracer = Tracer(scene)
        self.periphery = Periphery(device_arrays(), forest, viewing or Viewing())
        self.denoised = denoised

    def frame(self, camera: Camera, foveation: Foveation, spp: int = 1, seed: int = 0) -> Frame:
        """One frame.

        Args:
            camera: the view.
            foveation: gaze and radii.
            spp: samples per pixel in the disc.
            seed: same seed, same frame.
        """
        clock = _Clock()
        plan = foveation.plan(camera.width, camera.height)
        clock.lap("plan")
        detail = self.periphery.detail(camera, foveation.gaze, foveation.fov_b)
        clock.lap("detail")
        drawn = self.periphery.draw(camera, detail, plan)
        periphery = drawn.image()
        clock.lap("splat")
        fovea, guides = self.trace_disc(camera, plan, spp, seed)
        clock.lap("trace")
        if guides is not None:
            fovea = _denoise_disc(fovea, guides, periphery, plan)
            clock.lap("denoise")
        composite = blend(periphery, fovea, plan)
        clock.lap("blend")
        return Frame(composite, periphery, fovea, plan, detail, drawn.nodes, clock.milliseconds())

    def trace_disc(self, camera: Camera, plan: FoveaPlan, spp: int, seed: int) -> tuple[Image, Guides | None]:
        """Radiance (D, 3) of the plan's pixels and, where the disc is denoised, its guides."""
        if not len(plan.pixels):
            return np.zeros((0, 3), dtype=np.float32), None
        positions = pixel_positions(mi.UInt32(plan.pixels), camera.width)
        traced = self.tracer.trace(camera, positions, spp, seed, guides=self.denoised)
        return _interleaved(traced.radiance), _guides(traced)

    def disc_alone(self, camera: Camera, plan: FoveaPlan, spp: int, seed: int) -> Image:
        """(D, 3) the disc as a frame shows it, without the splats around it."""
        fovea, guides = self.trace_disc(camera, plan, spp, seed)
        if guides is None:
            return fovea
        around = np.zeros((plan.height, plan.width, 3), dtype=np.float32)
        return _denoise_disc(fovea, guides, around, plan)

    def splat_frame(self, camera: Camera) -> Image:
        """(H, W, 3) the finest layer over the whole frame, also where a fovea would hide it."""
        return self.periphery.whole(camera)

    def path_traced(self, camera: Camera, positions: FilmPositions, spp: int, seed: int) -> Image:
        """(H, W, 3) the whole frame, treated as the disc is: what the hybrid frame is compared with."""
        traced = self.tracer.trace(camera, positions, spp, seed, guides=self.denoised)
        shape = (camera.height, camera.width, 3)
        radiance, guides = _interleaved(traced.radiance).reshape(shape), _guides(traced)
        if guides is None:
            return radiance
        return denoise(radiance, guides[0].reshape(shape), guides[1].reshape(shape), fast=True)


Guides = tuple[Image, Image]  # albedo and normal, (D, 3) each


def _interleaved(channels: list[Any]) -> Image:
    return np.stack([channel.numpy() for channel in channels], axis=1)


def _guides(traced: Traced) -> Guides | None:
    if traced.albedo is None or traced.normal is None:
        return None
    return _interleaved(traced.albedo), _interleaved(traced.normal)


def _denoise_disc(fovea: Image, guides: Guides, periphery: Image, plan: FoveaPlan) -> Image:
    """Denoises the square around the disc, with the splats around the disc as context."""
    rows, columns = plan.pixels // plan.width, plan.pixels % plan.width
    top, left = int(rows.min()), int(columns.min())
    box = np.s_[top : int(rows.max()) + 1, left : int(columns.max()) + 1]
    place = rows - top, columns - left
    radiance = periphery[box].copy()
    # Outside the disc no guide was traced; the picture itself is the best one there is.
    albedo, normal = np.clip(radiance, 0, 1), np.zeros_like(radiance)
    for target, values in ((radiance, fovea), (albedo, guides[0]), (normal, guides[1])):
        target[place] = values
    return denoise(radiance, albedo, normal, fast=True)[place]


class _Clock:
    """Laps of one frame, each ended by waiting for the device."""

    def __init__(self) -> None:
        self._start = self._last = time.perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        dr.sync_thread()
        now = time.perf_counter()
        self._laps[name] = (now - self._last) * 1000
        self._last = now

    def milliseconds(self) -> dict[str, float]:
        return {**self._laps, "total": (self._last - self._start) * 1000}
