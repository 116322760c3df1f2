"""Ways to make a frame: this project's, and what people would use instead, built from the same parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch.nn import functional

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from compose.image.colour import Image
from hybrid.baselines.warp import Warp
from hybrid.frame.periphery import Periphery
from hybrid.frame.renderer import HybridRenderer
from hybrid.frame.traced_image import traced_image
from hybrid.runtime.clock import Clock
from pathtrace.trace.film import box_positions, frame_positions
from pathtrace.trace.tracer import Tracer


@dataclass(frozen=True)
class Made:
    """A frame (H, W, 3) in linear radiance, and what each pass took, in milliseconds, with the total."""

    image: Image
    milliseconds: dict[str, float]


class Peer(Protocol):
    """A way to make a frame, with all its settings."""

    @property
    def settings(self) -> dict[str, float | str]:
        """What it is set to, for tables."""

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        """Paths per pixel of the frame."""

    def make(self, camera: Camera, gaze: Gaze, seed: int) -> Made:
        """A frame; same seed, same frame."""


@dataclass(frozen=True)
class Hybrid:
    """This project's frame; the renderer's mode says how its fovea is made."""

    renderer: HybridRenderer
    fov_a: float
    fov_b: float
    spp: int

    @property
    def settings(self) -> dict[str, float | str]:
        radii: dict[str, float | str] = {"fov_a": self.fov_a, "fov_b": self.fov_b}
        return {"fovea": self.renderer.fovea.mode, "spp": self.spp, **radii}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        region = Foveation(gaze, self.fov_a, self.fov_b).region(camera.width, camera.height)
        paths = region.weights.sum() if self.renderer.fovea.is_independent else len(region.pixels)
        return float(self.spp * paths / (camera.width * camera.height))

    def make(self, camera: Camera, gaze: Gaze, seed: int) -> Made:
        frame = self.renderer.frame(camera, Foveation(gaze, self.fov_a, self.fov_b), self.spp, seed)
        return Made(frame.composite, frame.milliseconds)


@dataclass(frozen=True)
class FullTrace:
    """Every pixel path-traced alike, as far as whole samples allow."""

    tracer: Tracer
    spp: float
    denoised: bool

    @property
    def settings(self) -> dict[str, float | str]:
        return {"spp": self.spp}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return self.spp

    def make(self, camera: Camera, gaze: Gaze, seed: int) -> Made:
        clock = Clock()
        positions = frame_positions(camera)
        image = traced_image(
            self.tracer, camera, positions, camera.width, self.spp, seed, self.denoised, clock
        )
        return Made(image, clock.milliseconds())


@dataclass(frozen=True)
class Enlarged:
    """The whole frame path-traced with fewer, larger pixels, and enlarged bicubically.

    Attributes:
        share: of the frame's pixels.
    """

    tracer: Tracer
    share: float
    spp: int
    denoised: bool

    @property
    def settings(self) -> dict[str, float | str]:
        return {"spp": self.spp, "scale": float(np.sqrt(self.share))}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        columns, rows = self._size(camera)
        return self.spp * columns * rows / (camera.width * camera.height)

    def make(self, camera: Camera, gaze: Gaze, seed: int) -> Made:
        clock = Clock()
        columns, rows = self._size(camera)
        width, height = camera.width / columns, camera.height / rows
        left, top = (
            side.ravel() for side in np.meshgrid(np.arange(columns) * width, np.arange(rows) * height)
        )
        positions = box_positions(left, top, np.full(left.shape, width), np.full(left.shape, height))
        small = traced_image(self.tracer, camera, positions, columns, self.spp, seed, self.denoised, clock)
        planes = torch.from_numpy(small).permute(2, 0, 1)[None]
        size = (camera.height, camera.width)
        large = functional.interpolate(planes, size=size, mode="bicubic")[0].permute(1, 2, 0).clamp(min=0)
        image = np.ascontiguousarray(large.numpy())
        clock.lap("enlarge")
        return Made(image, clock.milliseconds())

    def _size(self, camera: Camera) -> tuple[int, int]:
        scale = float(np.sqrt(self.share))
        return max(1, round(camera.width * scale)), max(1, round(camera.height * scale))


@dataclass(frozen=True)
class Warped:
    """RMFR: path-traced in a smaller buffer that is densest at the gaze."""

    tracer: Tracer
    f: float
    sigma: float
    spp: float
    denoised: bool

    @property
    def settings(self) -> dict[str, float | str]:
        return {"spp": self.spp, "f": self.f, "sigma": self.sigma, "denoised": str(self.denoised).lower()}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        warp = Warp.of(gaze, camera.width, camera.height, self.f, self.sigma)
        return self.spp * warp.across.buffer * warp.down.buffer / (camera.width * camera.height)

    def make(self, camera: Camera, gaze: Gaze, seed: int) -> Made:
        clock = Clock()
        warp = Warp.of(gaze, camera.width, camera.height, self.f, self.sigma)
        positions = box_positions(*warp.boxes())
        columns = warp.across.buffer
        buffer = traced_image(self.tracer, camera, positions, columns, self.spp, seed, self.denoised, clock)
        image = warp.frame(buffer)
        clock.lap("enlarge")
        return Made(image, clock.milliseconds())


@dataclass(frozen=True)
class Splats:
    """Gaussians alone, all of the finest layer at full rate."""

    periphery: Periphery

    @property
    def settings(self) -> dict[str, float | str]:
        return {"gaussians": self.periphery.forest.counts[-1]}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return 0.0

    def make(self, camera: Camera, gaze: Gaze, seed: int) -> Made:
        clock = Clock()
        image = self.periphery.whole(camera)
        clock.lap("splat")
        return Made(image, clock.milliseconds())
