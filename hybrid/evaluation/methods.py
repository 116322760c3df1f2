"""Methods of rendering a frame, behind one interface: hybrid frames, splats alone, and path-traced baselines.

These take any number of rays per pixel: full frames, enlarged ones, and RMFR. Rectangular mapping-based
foveated rendering (RMFR) traces a smaller buffer, densest at the gaze. Both axes are mapped separately in the
same way. With x the offset from the gaze and M the distance from the gaze to the edge on that side, in
fractions of the frame's side, x maps to x (f + M) / (f + |x|) in the buffer (Ye et al. 2022, as used by
Foveated Path Culling). f controls how much of the buffer the surroundings of the gaze get; sigma is the side
of the frame over that of the buffer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.base.compute_device import PassClock
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import DEFAULTS, FrameSettings
from hybrid.render.periphery import Periphery
from pathtrace.trace.film import FilmPositions, box_positions, fractional_counts, frame_positions
from pathtrace.trace.traced_images import TracedImage, auxiliary_images, radiance_image, trace_image
from pathtrace.trace.tracer import Tracer, auxiliary_spp


@dataclass(frozen=True)
class TimedImage:
    """A frame, (H, W, 3) linear radiance, and its milliseconds per pass and in total."""

    image: Image
    milliseconds: dict[str, float]


class Method(Protocol):
    """A method of rendering frames, together with its settings."""

    @property
    def settings(self) -> dict[str, Any]:
        """Its settings as JSON has them, for tables."""

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        """Expected number of paths per pixel of the frame."""

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        """One frame; same seed, same frame on the same machine.

        The scene's step to the view's time is not a part of the milliseconds: it is the same for all.
        """


@dataclass(frozen=True)
class HybridMethod:
    """Renders hybrid frames with settings whose gaze and camera each frame sets."""

    renderer: Renderer
    frame_settings: FrameSettings

    @property
    def settings(self) -> dict[str, Any]:
        used = self.frame_settings
        return {"fovea": used.fovea.value, "spp": used.spp, "fov_a": used.fov_a, "fov_b": used.fov_b}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return self.renderer.paths(self._at(camera, gaze)) / (camera.width * camera.height)

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        self.renderer.scene.show(view.time)
        frame = self.renderer.frame(replace(self._at(view.camera, gaze), time=view.time), seed)
        return TimedImage(frame.composite, frame.milliseconds)

    def _at(self, camera: Camera, gaze: Gaze) -> FrameSettings:
        return replace(self.frame_settings, camera=camera, gaze=gaze)


@dataclass(frozen=True)
class SplatsAlone:
    """Renders all Gaussians of the finest layer at full rate."""

    periphery: Periphery

    @property
    def settings(self) -> dict[str, Any]:
        return {"gaussians": self.periphery.forest.counts[-1]}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return 0.0

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        clock = PassClock()
        self.periphery.set_time(view.time)
        image = self.periphery.whole(view.camera, DEFAULTS).numpy()
        clock.lap("splat")
        return TimedImage(image, clock.milliseconds())


Array = NDArray[np.float64]
# Foveated Path Culling's (FPC's) settings of RMFR.
_FPC_F, _FPC_SIGMA = 0.1, 2.6


@dataclass(frozen=True)
class Axis:
    """The mapping along one axis, from `size` pixels of the frame to `buffer` pixels of the buffer.

    The gaze is a position in 0..1. The smaller f, above 0, the more of the buffer goes to the surroundings of
    the gaze.
    """

    gaze: float
    f: float
    size: int
    buffer: int

    def buffer_of(self, pixels: Array) -> Array:
        """(N,) buffer coordinates in pixels, of frame coordinates (N,) in pixels."""
        offset = pixels / self.size - self.gaze
        return (self.gaze + offset * (self.f + self._far(offset)) / (self.f + np.abs(offset))) * self.buffer

    def frame_of(self, pixels: Array) -> Array:
        """(N,) frame coordinates in pixels, of buffer coordinates (N,) in pixels."""
        offset = pixels / self.buffer - self.gaze
        return (self.gaze + self.f * offset / (self.f + self._far(offset) - np.abs(offset))) * self.size

    def _far(self, offset: Array) -> Array:
        """Distance from the gaze to the edge on the side of an offset."""
        return np.where(offset < 0, self.gaze, 1 - self.gaze)


@dataclass(frozen=True)
class Warp:
    """The mapping of a frame, along its width (across) and along its height (down)."""

    across: Axis
    down: Axis

    @staticmethod
    def of(gaze: Gaze, width: int, height: int, f: float, sigma: float) -> Warp:
        """The mapping into a buffer with sides smaller by sigma, above 0."""
        sides = ((gaze.x, width), (gaze.y, height))
        return Warp(*(Axis(at, f, size, max(1, round(size / sigma))) for at, size in sides))

    def boxes(self) -> tuple[Array, Array, Array, Array]:
        """(N,) each: left, top, width and height of what buffer pixels cover, in frame pixels."""
        edges = [axis.frame_of(np.arange(axis.buffer + 1.0)) for axis in (self.across, self.down)]
        left, top = np.meshgrid(edges[0][:-1], edges[1][:-1])
        width, height = np.meshgrid(np.diff(edges[0]), np.diff(edges[1]))
        return left.ravel(), top.ravel(), width.ravel(), height.ravel()

    def frame(self, buffer: Image) -> Image:
        """(H, W, 3) the frame of a buffer (rows, columns, 3), interpolated linearly."""
        rows, columns = _between(self.down), _between(self.across)
        mixed = buffer[rows[0]] * (1 - rows[2])[:, None, None] + buffer[rows[1]] * rows[2][:, None, None]
        across = columns[2][None, :, None]
        return np.asarray(
            mixed[:, columns[0]] * (1 - across) + mixed[:, columns[1]] * across, dtype=np.float32
        )


def _between(axis: Axis) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """(size,) each: the two buffer pixels beside each frame pixel's centre, and the second one's weight."""
    centres = np.arange(axis.size, dtype=np.float64) + 0.5
    position = np.clip(axis.buffer_of(centres) - 0.5, 0, axis.buffer - 1)
    first = np.minimum(position.astype(np.int64), max(0, axis.buffer - 2))
    return first, np.minimum(first + 1, axis.buffer - 1), (position - first).astype(np.float32)


@dataclass(frozen=True)
class _PathTraced:
    """A path-traced baseline: `spp` samples per traced pixel, at least 1; if fractional, the mean."""

    tracer: Tracer
    spp: float
    denoised: bool

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        self.tracer.scene.show(view.time)
        clock = PassClock()
        image = self._image(view.camera, gaze, seed, clock)
        return TimedImage(image, clock.milliseconds())

    def traced(
        self, camera: Camera, positions: FilmPositions, columns: int, seed: int, clock: PassClock
    ) -> Image:
        """(N / columns, columns, 3) radiance at N positions on the camera's film, given row by row.

        If denoised, OIDN is guided by albedo and normal. The clock records the passes trace and denoise.
        """
        counts = fractional_counts(self.spp, positions.count, seed)
        if self.denoised and isinstance(counts, int):
            traced = trace_image(self.tracer, camera, positions, columns, counts, seed)
        else:
            radiance = radiance_image(self.tracer, camera, positions, columns, counts, seed)
            if not self.denoised:
                clock.lap("trace")
                return radiance
            auxiliary_count = auxiliary_spp(math.ceil(self.spp))
            auxiliary = auxiliary_images(self.tracer, camera, positions, columns, auxiliary_count, seed)
            traced = TracedImage(radiance, *auxiliary)
        clock.lap("trace")
        image = traced.denoised()
        clock.lap("denoise")
        return image

    def _image(self, camera: Camera, gaze: Gaze, seed: int, clock: PassClock) -> Image:
        raise NotImplementedError


@dataclass(frozen=True)
class FullTrace(_PathTraced):
    """Traces all pixels with the same sample count."""

    @property
    def settings(self) -> dict[str, Any]:
        return {"spp": self.spp}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return self.spp

    def _image(self, camera: Camera, gaze: Gaze, seed: int, clock: PassClock) -> Image:
        return self.traced(camera, frame_positions(camera), camera.width, seed, clock)


@dataclass(frozen=True)
class Enlarged(_PathTraced):
    """Traces the whole frame with fewer, larger pixels and enlarges it bicubically, denoised before that.

    The share is the number of traced pixels over the frame's.
    """

    share: float

    @property
    def settings(self) -> dict[str, Any]:
        return {"spp": self.spp, "scale": float(np.sqrt(self.share))}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        columns, rows = self._size(camera)
        return self.spp * columns * rows / (camera.width * camera.height)

    def _image(self, camera: Camera, gaze: Gaze, seed: int, clock: PassClock) -> Image:
        columns, rows = self._size(camera)
        width, height = camera.width / columns, camera.height / rows
        left, top = (
            side.ravel() for side in np.meshgrid(np.arange(columns) * width, np.arange(rows) * height)
        )
        positions = box_positions(left, top, np.full(left.shape, width), np.full(left.shape, height))
        small = self.traced(camera, positions, columns, seed, clock)
        planes = torch.from_numpy(small).permute(2, 0, 1)[None]  # (1, 3, rows, columns)
        size = (camera.height, camera.width)
        # Bicubic weights overshoot at edges, below 0 as well.
        large = functional.interpolate(planes, size=size, mode="bicubic")[0].permute(1, 2, 0).clamp(min=0)
        image = np.ascontiguousarray(large.numpy())  # (H, W, 3)
        clock.lap("enlarge")
        return image

    def _size(self, camera: Camera) -> tuple[int, int]:
        scale = float(np.sqrt(self.share))
        return max(1, round(camera.width * scale)), max(1, round(camera.height * scale))


@dataclass(frozen=True)
class Rmfr(_PathTraced):
    """RMFR: traces a smaller buffer, densest at the gaze, denoised before it is mapped back to the frame."""

    f: float
    sigma: float

    @property
    def settings(self) -> dict[str, Any]:
        return {"spp": self.spp, "f": self.f, "sigma": self.sigma, "denoised": str(self.denoised).lower()}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        warp = self._warp(camera, gaze)
        return self.spp * warp.across.buffer * warp.down.buffer / (camera.width * camera.height)

    def _image(self, camera: Camera, gaze: Gaze, seed: int, clock: PassClock) -> Image:
        warp = self._warp(camera, gaze)
        positions, columns = box_positions(*warp.boxes()), warp.across.buffer
        image = warp.frame(self.traced(camera, positions, columns, seed, clock))
        clock.lap("enlarge")
        return image

    def _warp(self, camera: Camera, gaze: Gaze) -> Warp:
        return Warp.of(gaze, camera.width, camera.height, self.f, self.sigma)


@dataclass(frozen=True)
class WarpTuning:
    """Settings of RMFR that remain free at a given number of rays, with at least `spp` per buffer pixel."""

    f: float
    spp: int
    denoised: bool


@dataclass(frozen=True)
class Tuning:
    """Settings of the baselines that remain free at a given number of rays.

    The best ones of RMFR for the whole frame and for the fovea, and the least samples per pixel of the
    denoised enlarged frame.
    """

    frame: WarpTuning
    fovea: WarpTuning
    enlarged_spp: int

    @staticmethod
    def restored(found: dict[str, Any]) -> Tuning:
        """The tuning from the result of `asdict`."""
        return Tuning(WarpTuning(**found["frame"]), WarpTuning(**found["fovea"]), found["enlarged_spp"])


# From paths per pixel of the frame to a method that takes about as many.
Family = Callable[[float], Method]


def families(tracer: Tracer, tuning: Tuning) -> dict[str, Family]:
    """All path-traced baselines by name; RMFR with FPC's settings, and tuned."""
    found: dict[str, Family] = {
        "full": lambda rays: FullTrace(tracer, max(1.0, rays), denoised=False),
        "full, denoised": lambda rays: FullTrace(tracer, max(1.0, rays), denoised=True),
        "enlarged": lambda rays: enlarged(tracer, 1, rays, denoised=False),
        "enlarged, denoised": lambda rays: enlarged(tracer, tuning.enlarged_spp, rays, denoised=True),
        "rmfr": lambda rays: Rmfr(tracer, max(1.0, rays * _FPC_SIGMA**2), False, _FPC_F, _FPC_SIGMA),
        "rmfr, tuned": lambda rays: warped(tracer, tuning.frame, rays),
    }
    if tuning.fovea != tuning.frame:
        found["rmfr, tuned for the fovea"] = lambda rays: warped(tracer, tuning.fovea, rays)
    return found


def enlarged(tracer: Tracer, least_spp: int, rays: float, denoised: bool) -> Enlarged:
    """The enlarged frame with that many rays per frame pixel, and at least `least_spp` per traced pixel."""
    spp = _whole_spp(least_spp, rays)
    return Enlarged(tracer, spp, denoised, rays / spp)


def warped(tracer: Tracer, tuning: WarpTuning, rays: float) -> Rmfr:
    """RMFR with that many rays per frame pixel, and at least the tuned samples per buffer pixel."""
    spp = _whole_spp(tuning.spp, rays)
    return Rmfr(tracer, spp, tuning.denoised, tuning.f, float(np.sqrt(spp / rays)))


def _whole_spp(least_spp: int, rays: float) -> int:
    """Samples per pixel of a smaller image: enough that it has no more pixels than the frame."""
    return max(least_spp, math.ceil(rays))
