"""The disc as images: its samples and the underlay, in the rectangle around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compose.fovea.rectangle import Rectangle
from compose.fovea.region import FoveaRegion
from compose.fovea.samples import Samples
from compose.fusion.parents import Parents
from compose.image.colour import Image
from hybrid.frame.underlay import Underlay
from pathtrace.base.denoise import denoise, denoise_coarsely


def parents_of(region: FoveaRegion, samples: Samples, underlay: Underlay, quick: bool = False) -> Parents:
    """The images that are fused, cropped to the rectangle around the disc.

    Args:
        region: the disc.
        samples: of its pixels.
        underlay: of the same view.
        quick: whether to use the quicker denoiser.
    """
    rectangle = region.rectangle
    splats = rectangle.crop(underlay.radiance)
    images = DiscImages.of(samples, splats, rectangle)
    return Parents(
        traced=images.radiance,
        variance=rectangle.scattered(np.full_like(splats, np.inf), samples.variance()),
        denoised=denoised_for_fusion(images, quick),
        splat=splats,
        albedo=images.albedo,
        normal=images.normal,
        count=images.count,
        enlargement=underlay.enlargement,
        quick=quick,
    )


@dataclass(frozen=True)
class DiscImages:
    """Samples and their auxiliary features as images.

    Attributes:
        radiance: (h, w, 3) linear, mean of the samples.
        albedo, normal: (h, w, 3).
        count: (h, w, 1) samples per pixel.
    """

    radiance: Image
    albedo: Image
    normal: Image
    count: Image

    @staticmethod
    def of(samples: Samples, surroundings: Image, rectangle: Rectangle) -> DiscImages:
        """The samples of a disc, in the rectangle around it.

        Args:
            samples: of the disc's D pixels.
            surroundings: (h, w, 3) radiance of the rectangle's pixels outside the disc.
            rectangle: around the disc.
        """
        scattered = rectangle.scattered
        return DiscImages(
            scattered(surroundings, samples.radiance),
            # No albedo is traced outside the disc; the image is the best substitute.
            scattered(np.clip(surroundings, 0, 1), samples.albedo),
            scattered(np.zeros_like(surroundings), samples.normal),
            scattered(np.ones((*rectangle.shape, 1), dtype=np.float32), samples.count[:, None]),
        )

    def denoised(self, quick: bool) -> Image:
        """(h, w, 3) denoised radiance, by the quicker network if `quick`."""
        return denoise(self.radiance, self.albedo, self.normal, quick)


def denoised_for_fusion(images: DiscImages, quick: bool) -> Image:
    """(h, w, 3) denoised radiance, as one parent of several; at half the resolution if `quick`."""
    denoiser = denoise_coarsely if quick else denoise
    return denoiser(images.radiance, images.albedo, images.normal)
