"""The fovea of a frame: samples of the disc, denoised, fused with the splats under it, with their history."""

from __future__ import annotations

from dataclasses import dataclass

from compose.camera.camera import Camera
from compose.fovea.mode import mode_named
from compose.fovea.region import FoveaRegion
from compose.fovea.samples import Samples
from compose.fusion.combination import fuse
from compose.fusion.network import Fusion
from compose.image.colour import Image
from hybrid.frame.disc import DiscImages, Underlay, checked, parents_of
from hybrid.frame.disc_tracer import DiscTracer
from hybrid.runtime.threads import torch_alone
from pathtrace.trace.tracer import Tracer


@dataclass(frozen=True)
class FoveaPicture:
    """The fovea and what it was made of, for the D pixels of a plan.

    Attributes:
        radiance: (D, 3) linear.
        samples: per pixel, with those of earlier frames.
        denoised: (D, 3), unless raw.
        weights: (D, 3) share of each parent (compose.fusion.PARENTS), only if fused.
        excluded: pixels in which a parent was left out because it was not finite or negative.
    """

    radiance: Image
    samples: Samples
    denoised: Image | None = None
    weights: Image | None = None
    excluded: int = 0


class Fovea:
    """Makes the foveas of one scene.

    Args:
        tracer: of the scene.
        mode: raw, what Mitsuba gives, unbiased; denoised, by OIDN; fused, with the splats as well.
        fusion: fitted to the scene and its splats; None fuses by statistics alone.
        remembers: whether samples of earlier frames count.

    Raises:
        UserError: there is no such mode.
    """

    def __init__(self, tracer: Tracer, mode: str, fusion: Fusion | None = None, remembers: bool = False):
        self.mode = mode_named(mode)
        self.disc = DiscTracer(tracer, mode != "raw", remembers)
        self._fusion = fusion

    @property
    def is_independent(self) -> bool:
        """Whether a pixel shows its own samples of this frame and nothing else."""
        return self.mode == "raw" and self.disc.history is None

    def picture(
        self,
        camera: Camera,
        region: FoveaRegion,
        samples: Samples,
        around: Image | None,
        underlay: Underlay | None,
        quick: bool = False,
    ) -> FoveaPicture:
        """The fovea that the samples give.

        Args:
            camera: the view.
            plan: the disc.
            samples: of its pixels.
            around: (H, W, 3) radiance that stands in for the corners of the rectangle around the disc; only
                looked at if denoised.
            under: the splats under the disc, of the same view; only looked at if fused.
            hurried: whether a fused fovea takes the quicker denoiser, however many samples there are.

        Raises:
            ValueError: the splats' picture is missing, or of another camera or size.
        """
        if self.mode == "raw" or not len(region.pixels):
            return FoveaPicture(samples.radiance, samples)
        rectangle = region.rectangle
        taken = rectangle.taken
        if self.mode == "denoised":
            assert around is not None
            scattered = DiscImages.of(samples, rectangle.crop(around), rectangle)
            denoised = taken(scattered.denoised())
            return FoveaPicture(denoised, samples, denoised)
        parents = parents_of(region, samples, checked(camera, underlay), quick)
        with torch_alone():
            fused = fuse(parents, self._fusion)
        return FoveaPicture(
            taken(fused.radiance), samples, taken(parents.denoised), taken(fused.weights), fused.excluded
        )
