"""A disc as images: its samples and the splats under it, in the rectangle around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compose.camera.camera import Camera
from compose.fovea.rectangle import Rectangle
from compose.fovea.region import FoveaRegion
from compose.fovea.samples import Samples
from compose.fusion.combination import QUICK_BELOW
from compose.fusion.parents import Parents
from compose.image.colour import Image
from pathtrace.base.denoise import denoise, denoise_coarsely


@dataclass(frozen=True)
class Underlay:
    """The splats' picture under the disc.

    Attributes:
        camera: the view.
        radiance: (H, W, 3) of the whole frame; only the rectangle around the disc is looked at.
        enlargement: side of the pixels that the splats were trained on, in pixels of this picture.
    """

    camera: Camera
    radiance: Image
    enlargement: float


def checked(camera: Camera, underlay: Underlay | None) -> Underlay:
    """The underlay, if it is one of that camera.

    Raises:
        ValueError: it is missing, or of another camera or size.
    """
    if underlay is None:
        raise ValueError("a fused fovea needs the splats' picture under the disc")
    size = underlay.radiance.shape[:2]
    if size != (camera.height, camera.width):
        raise ValueError(
            f"the splats' picture is {size[1]} x {size[0]}, the frame {camera.width} x {camera.height}"
        )
    if underlay.camera.key != camera.key:
        raise ValueError("the splats' picture is one of another camera")
    return underlay


def parents_of(region: FoveaRegion, samples: Samples, underlay: Underlay, quick: bool = False) -> Parents:
    """All that is known of the rectangle around the disc; denoised by the quicker way if hurried."""
    rectangle = region.rectangle
    splat = rectangle.crop(underlay.radiance)
    scattered = DiscImages.of(samples, splat, rectangle)
    variance = rectangle.scattered(np.full_like(splat, np.inf), samples.variance())
    auxiliary = scattered.albedo, scattered.normal, scattered.count
    denoised = scattered.denoised_for_fusion(quick)
    return Parents(scattered.radiance, variance, denoised, splat, *auxiliary, underlay.enlargement, quick)


def denoised_for_fusion(
    radiance: Image, albedo: Image, normal: Image, spp: float, quick: bool = False
) -> Image:
    """(H, W, 3) denoised as one parent of several: with few samples, not worth its full price."""
    if quick or is_quick(spp):
        return denoise_coarsely(radiance, albedo, normal)
    return denoise(radiance, albedo, normal)


@dataclass(frozen=True)
class DiscImages:
    """A disc's samples in the rectangle around it; outside of the disc, what is known of that.

    Attributes:
        radiance, albedo, normal: (h, w, 3).
        count: (h, w, 1).
    """

    radiance: Image
    albedo: Image
    normal: Image
    count: Image

    @staticmethod
    def of(samples: Samples, around: Image, rectangle: Rectangle) -> DiscImages:
        scattered = rectangle.scattered
        return DiscImages(
            scattered(around, samples.radiance),
            # Outside the disc no guide was traced; the picture itself is the best one there is.
            scattered(np.clip(around, 0, 1), samples.albedo),
            scattered(np.zeros_like(around), samples.normal),
            scattered(np.ones((*rectangle.shape, 1), dtype=np.float32), samples.count[:, None]),
        )

    def denoised(self) -> Image:
        """(h, w, 3)."""
        return denoise(self.radiance, self.albedo, self.normal, is_quick(float(self.count.mean())))

    def denoised_for_fusion(self, quick: bool) -> Image:
        """(h, w, 3) as one parent of several."""
        return denoised_for_fusion(self.radiance, self.albedo, self.normal, float(self.count.mean()), quick)


def is_quick(spp: float) -> bool:
    """Whether the quicker denoiser is the better deal at so many samples per pixel."""
    return spp < QUICK_BELOW
