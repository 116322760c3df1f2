"""The fovea of a frame: its samples, and the image made from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr

from compose.camera.camera import Camera
from compose.fovea.disc import Disc, thinned
from compose.fovea.foveation import FoveaMode
from compose.fovea.samples import Samples
from compose.fusion.combination import Fusion
from compose.fusion.maps import pixels_of
from compose.image.device_image import DeviceImage
from hybrid.render.disc_images import DiscImages, Underlay, parents_of, smooth
from hybrid.render.disc_tracer import DiscRequest, DiscTracer
from pathtrace.trace.tracer import Tracer

if TYPE_CHECKING:
    from drjit.auto.ad import Float


# Samples per pixel from which denoising them makes a fused fovea better, by 0.3 dB with two (mean over twelve
# scenes); and the expected error of splats from which it does so with single ones, by 0.1 to 2 dB.
_DENOISED_FROM, _DENOISED_OVER = 2, 5e-4


@dataclass(frozen=True)
class FoveaImage:
    """The fovea and what it was made from, for the D pixels of a disc; channels are Floats (D,).

    Attributes:
        disc: the pixels, and the weights of the blend.
        radiance: three channels, linear.
        samples: of each pixel, including those of earlier frames.
        denoised: three channels, linear radiance; None if raw, or fused without it.
        weights: share of each parent (compose.fusion.parents.PARENTS), a channel each; None unless fused.
        excluded: pixels in which a parent was left out (compose.fusion.parents.Fused).
    """

    disc: Disc
    radiance: list[Float]
    samples: Samples
    denoised: list[Float] | None = None
    weights: list[Float] | None = None
    excluded: int = 0


class Fovea:
    """Traces and reconstructs the foveas of one scene.

    With a history, samples of earlier frames are reused.
    """

    def __init__(self, tracer: Tracer, history: bool = False):
        self.disc = DiscTracer(tracer, history)

    def thins_band(self, mode: FoveaMode) -> bool:
        """Whether fewer samples are traced in the band; only possible if no other pixel depends on them."""
        return mode is FoveaMode.RAW and not self.disc.has_history

    def paths(self, mode: FoveaMode, disc: Disc, spp: int) -> float:
        """Expected number of paths that `trace` takes for a disc."""
        if self.thins_band(mode) and disc.count:
            return spp * float(dr.sum(disc.weights)[0])
        return float(spp * disc.count)

    def trace(
        self,
        mode: FoveaMode,
        camera: Camera,
        disc: Disc,
        spp: int,
        seed: int,
        underlay: Underlay | None = None,
        quick: bool = False,
    ) -> tuple[Disc, Samples]:
        """Traces the disc with `spp` samples per pixel, for a fovea that will be made in a mode.

        A fused fovea requires the underlay, the splats under the disc. If `quick`, samples are distributed
        evenly, which takes less time. Returns the pixels that have samples, with the weights of the blend;
        and the samples.
        """
        if self.thins_band(mode):
            thin, counts = thinned(disc, spp, seed)
            return thin, self.disc.trace_each(camera, thin.pixels, counts, seed)
        auxiliary = mode is not FoveaMode.RAW
        return disc, self.disc.trace(DiscRequest(camera, disc, spp, seed, auxiliary), underlay, quick)

    def image(
        self,
        mode: FoveaMode,
        disc: Disc,
        samples: Samples,
        surroundings: DeviceImage | None = None,
        underlay: Underlay | None = None,
        quick: bool = False,
    ) -> FoveaImage:
        """Makes the fovea from the samples of the disc's pixels, in less time if `quick`.

        Then a denoised one is made by the quicker denoiser, and a fused one without denoised samples, as
        always where that is not worth its time. A denoised fovea requires the surroundings, radiance
        that fills the disc's image where it has no samples; a fused one requires the underlay, the splats
        under the disc, in the same view. ValueError if they are missing.
        """
        if mode is FoveaMode.RAW or not disc.count:
            return FoveaImage(disc, samples.radiance, samples)
        if mode is FoveaMode.DENOISED:
            if surroundings is None:
                raise ValueError("a denoised fovea requires the radiance around the disc")
            images = DiscImages.of(disc, samples, disc.of_frame(surroundings))
            flat: Float = disc.arrays.plain.Float(images.denoised(quick).array)
            denoised = pixels_of(flat)(disc.inside)
            return FoveaImage(disc, denoised, samples, denoised)
        if underlay is None:
            raise ValueError("a fused fovea requires the splats under the disc")
        quick = quick or not worth_denoising(samples.mean_count(), underlay.expected)
        parents = parents_of(disc, samples, underlay, quick)
        fusion = Fusion(parents)
        fused = fusion.fused(smooth(fusion.ratio), disc.inside)
        made = FoveaImage(disc, fused.radiance, samples, None, fused.weights, fused.excluded)
        if parents.denoised is None:
            return made
        return replace(made, denoised=pixels_of(parents.denoised)(disc.inside))


def worth_denoising(spp: float, expected: float) -> bool:
    """Whether a fused fovea is better with denoised samples, so many per pixel, than with splats alone.

    What is expected is the splats' error, as in Parents.
    """
    return spp >= _DENOISED_FROM or expected > _DENOISED_OVER
