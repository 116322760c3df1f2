"""The disc as images: its samples and the splats under it, in the rectangle around it or in tiles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import mitsuba_oidn
import numpy as np

from compose.camera.camera import Camera
from compose.fovea.disc import Disc
from compose.fovea.samples import Samples
from compose.fusion.parents import TYPICAL_ERROR, Parents
from compose.image.colour import MOST, Image, filled, outliers
from compose.image.device_image import DeviceImage, all_plain
from pathtrace.trace.traced_images import denoise

if TYPE_CHECKING:
    from drjit.auto.ad import Float, TensorXf


@dataclass(frozen=True)
class Underlay:
    """The splats rendered under the disc, one of the images from which a fused fovea is made.

    The radiance is linear and of the whole frame (ValueError if it is not); only the rectangle around the
    disc is used. What is expected is the splats' error, as in Parents.
    """

    camera: Camera
    radiance: DeviceImage
    expected: float = TYPICAL_ERROR

    def __post_init__(self) -> None:
        width, height = self.radiance.width, self.radiance.height
        if (width, height) != (self.camera.width, self.camera.height):
            raise ValueError(
                f"the underlay is {width} x {height}, the frame {self.camera.width} x {self.camera.height}"
            )


def parents_of(disc: Disc, samples: Samples, underlay: Underlay, quick: bool = False) -> Parents:
    """The images that are fused, of the disc's pixels; if `quick`, without denoised samples."""
    splats = disc.of_frame(underlay.radiance)
    moments = [*samples.variance(), samples.earlier]
    dr.schedule(moments)
    images = DiscImages.of(disc, samples, splats)
    *variance, earlier = disc.images(moments, [*[dr.inf] * 3, 0.0])
    denoised = None
    if not quick:
        # Tiles with their borders have twice as many pixels.
        denoised = denoise(*_plain(images.tensors()), disc.tiling is not None).array
    fused = {
        "traced": images.radiance,
        "variance": variance,
        "splat": splats,
        "albedo": images.albedo,
        "count": [images.count],
        "earlier": [earlier],
    }
    return Parents.of(disc.arrays, disc.shape, fused, denoised, underlay.expected)


def smooth(image: TensorXf) -> TensorXf:
    """(H, W, 3) without Monte Carlo noise, by the quicker denoiser without auxiliary features."""
    dr.eval(image)
    # OIDN does not know of Dr.Jit's queue.
    dr.sync_thread()
    return mitsuba_oidn.denoise(image, hdr=True, quality=mitsuba_oidn.Quality.Fast)


@dataclass(frozen=True)
class DiscImages:
    """Samples and their auxiliary features as images of a disc, Floats (h * w,).

    Radiance (linear, the mean of the samples), albedo and normal have three channels each; the count is that
    of samples per pixel. They are not evaluated: not all are always used.
    """

    disc: Disc
    radiance: list[Float]
    albedo: list[Float]
    normal: list[Float]
    count: Float

    @staticmethod
    def of(disc: Disc, samples: Samples, surroundings: list[Float]) -> DiscImages:
        """The samples of a disc's D pixels.

        Surroundings are three Floats (h * w,), radiance of the image's pixels outside the disc; those that
        are not finite, or out of proportion to all samples, count as black.
        """
        own = [*samples.radiance, *samples.albedo, *samples.normal, samples.count]
        # In one kernel with the brightest sample.
        dr.schedule(own, disc.inside)
        brightest: Float | float = 1.0
        for channel in samples.radiance:
            brightest = dr.maximum(brightest, dr.select(dr.isfinite(channel), channel, 0))
        most = MOST * dr.max(brightest)
        surroundings = [dr.select((channel >= 0) & (channel <= most), channel, 0) for channel in surroundings]
        # No albedo is traced outside the disc; the image is the best substitute.
        like_albedo = [dr.clip(channel, 0, 1) for channel in surroundings]
        channels = disc.images(own, [*surroundings, *like_albedo, *[0.0] * 3, 1.0])
        return DiscImages(disc, channels[:3], channels[3:6], channels[6:9], channels[9])

    def tensors(self) -> list[mi.TensorXf]:
        """Radiance, albedo and normal as tensors (h, w, 3)."""
        found = [self.disc.tensor(channels) for channels in (self.radiance, self.albedo, self.normal)]
        dr.eval(found)
        return found

    def denoised(self, quick: bool) -> mi.TensorXf:
        """(h, w, 3) tensor of denoised radiance, by the quicker network if `quick`; outliers stay."""
        radiance, albedo, normal = self.tensors()
        if all_plain(self.radiance):
            return denoise(radiance, albedo, normal, quick)
        image = np.asarray(radiance)
        wrong = outliers(image)
        right = np.asarray(denoise(type(radiance)(filled(image, wrong)), albedo, normal, quick))
        return type(radiance)(np.where(wrong, image, right))


def _plain(tensors: list[mi.TensorXf]) -> tuple[mi.TensorXf, mi.TensorXf, mi.TensorXf]:
    """Radiance, albedo and normal (h, w, 3), what surrounds them in place of outliers of radiance."""
    radiance, albedo, normal = tensors
    if not all_plain([radiance.array]):
        image: Image = np.asarray(radiance)
        radiance = type(radiance)(filled(image, outliers(image)))
    return radiance, albedo, normal
