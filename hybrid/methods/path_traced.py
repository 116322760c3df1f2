"""Path-traced baselines: at full resolution, enlarged, and warped around the gaze (RMFR)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from compose.camera.camera import Camera
from compose.camera.view import View
from compose.eye.gaze import Gaze
from hybrid.methods.method import TimedImage
from hybrid.methods.traced_image import traced_image
from hybrid.methods.warp import Warp
from hybrid.runtime.clock import Clock
from pathtrace.trace.film import box_positions, frame_positions
from pathtrace.trace.tracer import Tracer


def _shown(tracer: Tracer, view: View) -> Camera:
    """The camera of a view, whose time the scene shows from now on."""
    tracer.scene.show(view.time)
    return view.camera


@dataclass(frozen=True)
class FullTrace:
    """Traces all pixels with the same sample count.

    Attributes:
        tracer: of the scene.
        spp: samples per pixel, at least 1; of a fractional number the mean over all pixels.
        denoised: whether to denoise the image.
    """

    tracer: Tracer
    spp: float
    denoised: bool

    @property
    def settings(self) -> dict[str, Any]:
        return {"spp": self.spp}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return self.spp

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        camera = _shown(self.tracer, view)
        clock = Clock()
        positions = frame_positions(camera)
        image = traced_image(
            self.tracer, camera, positions, camera.width, self.spp, seed, self.denoised, clock
        )
        return TimedImage(image, clock.milliseconds())


@dataclass(frozen=True)
class Enlarged:
    """Traces the whole frame with fewer, larger pixels and enlarges it bicubically.

    Attributes:
        tracer: of the scene.
        share: number of traced pixels over the frame's.
        spp: samples per traced pixel.
        denoised: whether to denoise the image before enlarging it.
    """

    tracer: Tracer
    share: float
    spp: int
    denoised: bool

    @property
    def settings(self) -> dict[str, Any]:
        return {"spp": self.spp, "scale": float(np.sqrt(self.share))}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        columns, rows = self._size(camera)
        return self.spp * columns * rows / (camera.width * camera.height)

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        camera = _shown(self.tracer, view)
        clock = Clock()
        columns, rows = self._size(camera)
        width, height = camera.width / columns, camera.height / rows
        left, top = (
            side.ravel() for side in np.meshgrid(np.arange(columns) * width, np.arange(rows) * height)
        )
        positions = box_positions(left, top, np.full(left.shape, width), np.full(left.shape, height))
        small = traced_image(self.tracer, camera, positions, columns, self.spp, seed, self.denoised, clock)
        planes = torch.from_numpy(small).permute(2, 0, 1)[None]  # (1, 3, rows, columns)
        size = (camera.height, camera.width)
        # Bicubic weights overshoot at edges, below 0 as well.
        large = functional.interpolate(planes, size=size, mode="bicubic")[0].permute(1, 2, 0).clamp(min=0)
        image = np.ascontiguousarray(large.numpy())  # (H, W, 3)
        clock.lap("enlarge")
        return TimedImage(image, clock.milliseconds())

    def _size(self, camera: Camera) -> tuple[int, int]:
        """Columns and rows that are traced."""
        scale = float(np.sqrt(self.share))
        return max(1, round(camera.width * scale)), max(1, round(camera.height * scale))


@dataclass(frozen=True)
class Rmfr:
    """Rectangular mapping-based foveated rendering (RMFR, Ye et al. 2022).

    Traces a smaller buffer that is densest at the gaze, and maps it back to the frame.

    Attributes:
        tracer: of the scene.
        f, sigma: parameters of the mapping (hybrid.methods.warp).
        spp: samples per pixel of the buffer, at least 1; of a fractional number the mean.
        denoised: whether to denoise the buffer.
    """

    tracer: Tracer
    f: float
    sigma: float
    spp: float
    denoised: bool

    @property
    def settings(self) -> dict[str, Any]:
        return {"spp": self.spp, "f": self.f, "sigma": self.sigma, "denoised": str(self.denoised).lower()}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        warp = Warp.of(gaze, camera.width, camera.height, self.f, self.sigma)
        return self.spp * warp.across.buffer * warp.down.buffer / (camera.width * camera.height)

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        camera = _shown(self.tracer, view)
        clock = Clock()
        warp = Warp.of(gaze, camera.width, camera.height, self.f, self.sigma)
        positions, columns = box_positions(*warp.boxes()), warp.across.buffer
        buffer = traced_image(self.tracer, camera, positions, columns, self.spp, seed, self.denoised, clock)
        image = warp.frame(buffer)
        clock.lap("enlarge")
        return TimedImage(image, clock.milliseconds())
