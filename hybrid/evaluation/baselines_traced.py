"""Path-traced baselines: full frames, and frames of fewer, larger pixels that are enlarged."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.base.compute_device import PassClock
from hybrid.evaluation.methods import TimedImage
from pathtrace.trace.film import FilmPositions, box_positions, fractional_counts, frame_positions
from pathtrace.trace.traced_images import TracedImage, auxiliary_images, radiance_image, trace_image
from pathtrace.trace.tracer import Tracer, auxiliary_spp


@dataclass(frozen=True)
class PathTraced:
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
        if not self.denoised:
            counts = fractional_counts(self.spp, positions.count, seed)
            radiance = radiance_image(self.tracer, camera, positions, columns, counts, seed)
            clock.lap("trace")
            return radiance
        traced = self.with_features(camera, positions, columns, seed)
        clock.lap("trace")
        image = traced.denoised()
        clock.lap("denoise")
        return image

    def with_features(self, camera: Camera, positions: FilmPositions, columns: int, seed: int) -> TracedImage:
        """What `traced` denoises."""
        counts = fractional_counts(self.spp, positions.count, seed)
        if isinstance(counts, int):
            return trace_image(self.tracer, camera, positions, columns, counts, seed)
        radiance = radiance_image(self.tracer, camera, positions, columns, counts, seed)
        auxiliary = auxiliary_images(self.tracer, camera, positions, columns, auxiliary_count(self.spp), seed)
        return TracedImage(radiance, *auxiliary)

    def _image(self, camera: Camera, gaze: Gaze, seed: int, clock: PassClock) -> Image:
        raise NotImplementedError


@dataclass(frozen=True)
class FullTrace(PathTraced):
    """Traces all pixels with the same sample count."""

    @property
    def settings(self) -> dict[str, Any]:
        return {"spp": self.spp}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return self.spp

    def _image(self, camera: Camera, gaze: Gaze, seed: int, clock: PassClock) -> Image:
        return self.traced(camera, frame_positions(camera), camera.width, seed, clock)


@dataclass(frozen=True)
class Enlarged(PathTraced):
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
        positions, columns = self.texels(camera)
        small = self.traced(camera, positions, columns, seed, clock)
        image = enlargement(small, camera.height, camera.width)
        clock.lap("enlarge")
        return image

    def texels(self, camera: Camera) -> tuple[FilmPositions, int]:
        """Film positions of the larger pixels, row by row, and how many a row has."""
        columns, rows = self._size(camera)
        return grid_positions((0, 0), (camera.width / columns, camera.height / rows), columns, rows), columns

    def _size(self, camera: Camera) -> tuple[int, int]:
        return grid_size(camera.width, camera.height, self.share)


def enlarged(tracer: Tracer, least_spp: float, rays: float, denoised: bool) -> Enlarged:
    """The enlarged frame with that many rays per frame pixel, and at least `least_spp` per traced pixel."""
    spp, share = spp_and_share(least_spp, rays)
    return Enlarged(tracer, spp, denoised, share)


def spp_and_share(least_spp: float, rays: float) -> tuple[float, float]:
    """Samples per traced pixel, and the number of these over all pixels, at a number of rays per pixel.

    There are no more than all, so both grow with the rays, and with them the time.
    """
    spp = max(least_spp, rays)
    return spp, rays / spp


def auxiliary_count(spp: float) -> int:
    """Samples per pixel of auxiliary features that go with a mean of `spp` samples of radiance."""
    return auxiliary_spp(math.ceil(spp))


def grid_size(width: int, height: int, share: float) -> tuple[int, int]:
    """Columns and rows, at least 1, of about a share of width * height pixels."""
    return max(1, round(width * math.sqrt(share))), max(1, round(height * math.sqrt(share)))


def grid_positions(
    corner: tuple[float, float], size: tuple[float, float], columns: int, rows: int
) -> FilmPositions:
    """Film positions of equal boxes of a size (x, y) in pixels, row by row from the top left corner."""
    sides = (
        start + side * np.arange(count)
        for start, side, count in zip(corner, size, (columns, rows), strict=True)
    )
    left, top = (of.ravel() for of in np.meshgrid(*sides))
    return box_positions(left, top, *(np.full(left.shape, side) for side in size))


def enlargement(image: Image, height: int, width: int, mode: str = "bicubic") -> Image:
    """(height, width, C) image of a smaller one (h, w, C), 0 or more; the mode may also be "bilinear"."""
    # Bicubic weights overshoot at edges, below 0 as well.
    return _of_planes(functional.interpolate(_planes(image), size=(height, width), mode=mode).clamp(min=0))


def pooled(image: Image, size: tuple[int, int], maxima: bool = False) -> Image:
    """(*size, C) means of a larger image (H, W, C), or maxima."""
    pool = functional.adaptive_max_pool2d if maxima else functional.adaptive_avg_pool2d
    return _of_planes(pool(_planes(image), size))


def _planes(image: Image) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1)[None]


def _of_planes(planes: torch.Tensor) -> Image:
    return np.ascontiguousarray(planes[0].permute(1, 2, 0).numpy())
