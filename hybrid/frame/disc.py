"""The disc as images: its samples and the underlay, in the rectangle around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.fovea.rectangle import Rectangle
from compose.fovea.region import FoveaRegion
from compose.fovea.samples import Samples
from compose.fusion.parents import Parents
from compose.image.colour import Image
from compose.image.outliers import MOST, filled, is_plain, outliers
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
            surroundings: (h, w, 3) radiance of the rectangle's pixels outside the disc; those that are not
                finite, or out of proportion to all samples, count as black.
            rectangle: around the disc.
        """
        surroundings = _usable(surroundings, samples.radiance)
        scattered = rectangle.scattered
        return DiscImages(
            scattered(surroundings, samples.radiance),
            # No albedo is traced outside the disc; the image is the best substitute.
            scattered(np.clip(surroundings, 0, 1), samples.albedo),
            scattered(np.zeros_like(surroundings), samples.normal),
            scattered(np.ones((*rectangle.shape, 1), dtype=np.float32), samples.count[:, None]),
        )

    def denoised(self, quick: bool) -> Image:
        """(h, w, 3) denoised radiance, by the quicker network if `quick`; outliers stay as they are."""
        wrong = self.outliers()
        if wrong is None:
            return denoise(self.radiance, self.albedo, self.normal, quick)
        denoised = denoise(filled(self.radiance, wrong), self.albedo, self.normal, quick)
        return np.where(wrong, self.radiance, denoised)

    def outliers(self) -> NDArray[np.bool_] | None:
        """(h, w, 1) pixels that would spoil those around them; None if there are none."""
        return None if is_plain(self.radiance) else outliers(self.radiance)


def denoised_for_fusion(images: DiscImages, quick: bool) -> Image:
    """(h, w, 3) denoised radiance, as one parent of several; at half the resolution if `quick`."""
    denoiser, wrong = denoise_coarsely if quick else denoise, images.outliers()
    radiance = images.radiance if wrong is None else filled(images.radiance, wrong)
    return denoiser(radiance, images.albedo, images.normal)


def _usable(surroundings: Image, samples: NDArray[np.float32]) -> Image:
    """Surroundings (h, w, 3) that are black where they cannot be radiance beside samples (D, 3)."""
    if is_plain(surroundings):
        return surroundings
    brightest = float(samples.max(initial=1, where=np.isfinite(samples)))
    usable = np.isfinite(surroundings) & (surroundings >= 0) & (surroundings <= MOST * brightest)
    return np.where(usable.all(axis=2, keepdims=True), surroundings, 0)
