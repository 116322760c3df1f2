"""The disc of hybrid frames, over an enlarged frame in place of splats."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaRegion, Foveation
from compose.image.colour import Image
from compose.image.device_image import shape_of
from hybrid.base.compute_device import PassClock
from hybrid.evaluation.baselines_traced import (
    Enlarged,
    PathTraced,
    auxiliary_count,
    enlarged,
    enlargement,
    grid_positions,
    grid_size,
    pooled,
    spp_and_share,
)
from pathtrace.trace.film import fractional_counts
from pathtrace.trace.traced_images import TracedImage, auxiliary_images, radiance_image


@dataclass(frozen=True)
class DiscOverEnlarged(PathTraced):
    """Traces a disc around the gaze and the whole frame apart, and blends them as hybrid frames are blended.

    Both are denoised. They have larger pixels than the frame where their rays do not suffice for `spp`
    samples of each. Rays are per pixel of the frame; the disc gets a share of them.
    """

    foveation: Foveation  # its radii; the gaze is that of each frame
    rays_per_pixel: float
    disc_share: float

    @property
    def settings(self) -> dict[str, Any]:
        return {"spp": self.spp, "rays per pixel": self.rays_per_pixel, "disc share": self.disc_share}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        region = self._region(camera, gaze)
        around = self._around(region).rays(camera, gaze)
        if not region.count:
            return around
        spp, inside = self._texels(region)
        return around + float(spp * inside.sum() / (camera.width * camera.height))

    def _region(self, camera: Camera, gaze: Gaze) -> FoveaRegion:
        return replace(self.foveation, gaze=gaze).region(camera.width, camera.height)

    def _around(self, region: FoveaRegion) -> Enlarged:
        share = 1 - self.disc_share if region.count else 1.0
        return enlarged(self.tracer, self.spp, share * self.rays_per_pixel, self.denoised)

    def _texels(self, region: FoveaRegion) -> tuple[float, NDArray[np.bool_]]:
        """Samples per traced pixel, and which of the rectangle's (rows, columns) are traced: in the disc."""
        density = self.disc_share * self.rays_per_pixel * region.width * region.height / region.count
        spp, share = spp_and_share(self.spp, density)
        (down, across), (height, width) = region.box, shape_of(region.box)
        columns, rows = grid_size(width, height, share)
        x = across.start + (np.arange(columns) + 0.5) * width / columns - region.centre[0]
        y = down.start + (np.arange(rows) + 0.5) * height / rows - region.centre[1]
        return spp, (np.hypot(y[:, None], x) < region.outer) | region.covers_frame

    def _image(self, camera: Camera, gaze: Gaze, seed: int, clock: PassClock) -> Image:
        region = self._region(camera, gaze)
        frame = self._around(region)._image(camera, gaze, seed, clock)
        if not region.count:
            return frame
        traced = self._disc(camera, region, frame[region.box], seed)
        clock.lap("trace disc")
        image = traced.denoised()
        clock.lap("denoise disc")
        weight = region.weight_image()[region.box][..., None]
        frame[region.box] += weight * (enlargement(image, *shape_of(region.box)) - frame[region.box])
        clock.lap("blend")
        return frame

    def _disc(self, camera: Camera, region: FoveaRegion, around: Image, seed: int) -> TracedImage:
        """The traced rectangle around the disc; outside of that, it shows what is there in the frame."""
        spp, inside = self._texels(region)
        (rows, columns), (down, across) = inside.shape, region.box
        height, width = shape_of(region.box)
        corner, size = (across.start, down.start), (width / columns, height / rows)
        positions = grid_positions(corner, size, columns, rows)
        counts = fractional_counts(spp, inside.size, seed) * inside.ravel()
        radiance = radiance_image(self.tracer, camera, positions, columns, counts, seed)
        auxiliary = auxiliary_images(self.tracer, camera, positions, columns, auxiliary_count(spp), seed)
        return TracedImage(np.where(inside[..., None], radiance, pooled(around, (rows, columns))), *auxiliary)
