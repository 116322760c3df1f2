"""The fovea of a frame: its samples, and the image made from them."""

from __future__ import annotations

from dataclasses import dataclass

from compose.camera.camera import Camera
from compose.fovea.band import thinned
from compose.fovea.mode import FoveaMode
from compose.fovea.region import FoveaRegion
from compose.fovea.samples import Samples
from compose.fusion.combination import fuse
from compose.fusion.network import Fusion
from compose.image.colour import Image
from hybrid.frame.disc import DiscImages, parents_of
from hybrid.frame.disc_tracer import DiscRequest, DiscTracer
from hybrid.frame.underlay import Underlay
from hybrid.runtime.threads import torch_working_on
from pathtrace.trace.tracer import Tracer


@dataclass(frozen=True)
class FoveaImage:
    """The fovea and what it was made from, for the D pixels of a region.

    Attributes:
        radiance: (D, 3) linear.
        samples: of each pixel, including those of earlier frames.
        denoised: (D, 3) linear radiance; None if raw.
        weights: (D, 3) share of each parent (compose.fusion.parents.PARENTS); None unless fused.
        excluded: pixels in which a parent was left out (compose.fusion.parents.Fused).
    """

    radiance: Image
    samples: Samples
    denoised: Image | None = None
    weights: Image | None = None
    excluded: int = 0


class Fovea:
    """Traces and reconstructs the foveas of one scene.

    Args:
        tracer: of the scene.
        fusion: fitted to the scene and its splats; None fuses by statistics alone.
        history: whether samples of earlier frames are reused.
    """

    def __init__(self, tracer: Tracer, fusion: Fusion | None = None, history: bool = False):
        self.disc = DiscTracer(tracer, history)
        self._fusion = fusion

    def thins_band(self, mode: FoveaMode) -> bool:
        """Whether fewer samples are traced in the band; only possible if no other pixel depends on them."""
        return mode is FoveaMode.RAW and not self.disc.has_history

    def paths(self, mode: FoveaMode, region: FoveaRegion, spp: int) -> float:
        """Expected number of paths that `trace` takes for a region."""
        return float(spp * (region.weights.sum() if self.thins_band(mode) else len(region.pixels)))

    def trace(
        self,
        mode: FoveaMode,
        camera: Camera,
        region: FoveaRegion,
        spp: int,
        seed: int,
        underlay: Underlay | None = None,
        quick: bool = False,
    ) -> tuple[FoveaRegion, Samples]:
        """Traces the disc.

        Args:
            mode: how the fovea will be made.
            camera, region: the view and the disc.
            spp: samples per pixel.
            seed: same seed, same samples.
            underlay: the splats under the disc, for a fused fovea.
            quick: whether samples are distributed evenly, which takes less time.

        Returns:
            The region of the pixels that have samples, with the weights of the blend; and the samples.
        """
        if self.thins_band(mode):
            thin, counts = thinned(region, spp, seed)
            return thin, self.disc.trace_each(camera, thin.pixels, counts, seed)
        auxiliary = mode is not FoveaMode.RAW
        return region, self.disc.trace(DiscRequest(camera, region, spp, seed, auxiliary), underlay, quick)

    def image(
        self,
        mode: FoveaMode,
        region: FoveaRegion,
        samples: Samples,
        surroundings: Image | None = None,
        underlay: Underlay | None = None,
        quick: bool = False,
    ) -> FoveaImage:
        """Makes the fovea from its samples.

        Args:
            mode: how to make it.
            region: the disc.
            samples: of its pixels.
            surroundings: (H, W, 3) radiance that fills the corners of the rectangle around the disc; required
                for a denoised fovea only.
            underlay: the splats under the disc, in the same view; required for a fused fovea only.
            quick: whether the quicker denoiser is used.

        Raises:
            ValueError: what the mode requires is missing.
        """
        if mode is FoveaMode.RAW or not len(region.pixels):
            return FoveaImage(samples.radiance, samples)
        rectangle = region.rectangle
        if mode is FoveaMode.DENOISED:
            if surroundings is None:
                raise ValueError("a denoised fovea requires the radiance around the disc")
            images = DiscImages.of(samples, rectangle.crop(surroundings), rectangle)
            denoised = rectangle.gathered(images.denoised(quick))
            return FoveaImage(denoised, samples, denoised)
        if underlay is None:
            raise ValueError("a fused fovea requires the splats under the disc")
        parents = parents_of(region, samples, underlay, quick)
        with torch_working_on(parents.count.size):
            fused = fuse(parents, self._fusion)
        radiance, denoised, weights = (
            rectangle.gathered(image) for image in (fused.radiance, parents.denoised, fused.weights)
        )
        return FoveaImage(radiance, samples, denoised, weights, fused.excluded)
