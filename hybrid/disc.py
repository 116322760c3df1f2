"""A disc as images: its samples and the splats under it, in the rectangle around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compose.blend import Image
from compose.foveation import FoveaPlan
from compose.fusion import QUICK_BELOW, Parents
from compose.rectangle import Rectangle
from compose.samples import Samples
from compose.view import Camera
from pathtrace.denoise import denoise, denoise_coarsely


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


def checked(camera: Camera, under: Underlay | None) -> Underlay:
    """The underlay, if it is one of that camera.

    Raises:
        ValueError: it is missing, or of another camera or size.
    """
    if under is None:
        raise ValueError("a fused fovea needs the splats' picture under the disc")
    size = under.radiance.shape[:2]
    if size != (camera.height, camera.width):
        raise ValueError(
            f"the splats' picture is {size[1]} x {size[0]}, the frame {camera.width} x {camera.height}"
        )
    if under.camera.key != camera.key:
        raise ValueError("the splats' picture is one of another camera")
    return under


def parents_of(plan: FoveaPlan, samples: Samples, under: Underlay, hurried: bool = False) -> Parents:
    """All that is known of the rectangle around the disc; denoised by the quicker way if hurried."""
    rectangle = plan.rectangle
    splat = rectangle.part_of(under.radiance)
    laid = DiscImages.of(samples, splat, rectangle)
    variance = rectangle.laid(np.full_like(splat, np.inf), samples.variance())
    guides = laid.albedo, laid.normal, laid.count
    denoised = laid.denoised_for_fusion(hurried)
    return Parents(laid.radiance, variance, denoised, splat, *guides, under.enlargement, hurried)


def denoised_for_fusion(
    radiance: Image, albedo: Image, normal: Image, spp: float, hurried: bool = False
) -> Image:
    """(H, W, 3) denoised as one parent of several: with few samples, not worth its full price."""
    if hurried or is_quick(spp):
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
        laid = rectangle.laid
        return DiscImages(
            laid(around, samples.radiance),
            # Outside the disc no guide was traced; the picture itself is the best one there is.
            laid(np.clip(around, 0, 1), samples.albedo),
            laid(np.zeros_like(around), samples.normal),
            laid(np.ones((*rectangle.shape, 1), dtype=np.float32), samples.count[:, None]),
        )

    def denoised(self) -> Image:
        """(h, w, 3)."""
        return denoise(self.radiance, self.albedo, self.normal, is_quick(float(self.count.mean())))

    def denoised_for_fusion(self, hurried: bool) -> Image:
        """(h, w, 3) as one parent of several."""
        return denoised_for_fusion(self.radiance, self.albedo, self.normal, float(self.count.mean()), hurried)


def is_quick(spp: float) -> bool:
    """Whether the quicker denoiser is the better deal at so many samples per pixel."""
    return spp < QUICK_BELOW
