"""What an evaluation measures."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from compose.base.errors import UserError, as_plain_numbers, require_seed
from compose.eye.gaze import require_within_frame
from hybrid.measure.image_metrics import SSIM_MARGIN, plain_regions
from hybrid.render.frame_settings import EVALUATION, MOST_SPP, FrameSettings

# References have this many times the samples in the disc, where differences are smallest and most visible.
FOVEAL_REFERENCE = 2
# Baselines are tuned on frames with sides smaller by this.
TUNING_REDUCTION = 2
# Smaller images have no level in FovVideoVDP's pyramid, and denser displays hundreds.
_LEAST_CROP = 4
_DENSEST = 10_000


@dataclass(frozen=True)
class EvaluationSettings:
    """What an evaluation measures.

    Attributes:
        frame: settings of the hybrid frames; views set the camera, and methods how the fovea is made.
        width, height: frame size in pixels.
        views: number of views between those of a training.
        apart: number of views beyond the prepared region, and of wider ones, which are shown apart.
        seeds: frames per method and view whose noise is independent; their quality is averaged.
        reference_spp: samples per pixel of the references; FOVEAL_REFERENCE times as many in the disc.
        denoised_references: whether references are denoised; otherwise no denoiser has touched them.
        repeats: timed frames per method and view.
        quick: only baselines at equal time; neither those at equal rays, nor frames of other sample counts
            or without a part, nor views apart. What is left has as many samples and views.
        seed: same seed, same quality on the same machine; from 0 to compose.base.errors.MOST_SEED.

    Raises:
        UserError: a count, a size or the seed is out of range, the gaze lies outside the frame, or there is
            no disc.
    """

    frame: FrameSettings = EVALUATION
    width: int = 512
    height: int = 512
    views: int = 20
    apart: int = 3
    seeds: int = 3
    reference_spp: int = 384
    denoised_references: bool = True
    repeats: int = 8
    quick: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        as_plain_numbers(self)
        for name in ("width", "height", "views", "seeds", "reference_spp", "repeats"):
            if getattr(self, name) <= 0:
                raise UserError(f"{name.replace('_', '-')} {getattr(self, name)}: must be positive")
        if self.apart < 0:
            raise UserError(f"apart {self.apart}: must not be negative")
        most = MOST_SPP // FOVEAL_REFERENCE
        if self.reference_spp > most:
            raise UserError(f"reference-spp {self.reference_spp}: must be at most {most}")
        require_seed(self.seed)
        require_within_frame(self.frame.gaze.x, self.frame.gaze.y)
        if self.frame.fov_a == 0:
            raise UserError("fov-a 0.0: there is no fovea to evaluate")

    def require_measurable(self) -> None:
        """Checks that all metrics can be computed in all regions, in frames and in those for tuning.

        UserError if the display is too dense, the frame is smaller than SSIM's window at half its size, or a
        region is empty or too small for the metrics.
        """
        density = self.frame.display.pixels_per_degree
        if density > _DENSEST:
            raise UserError(
                f"display fov {self.frame.display.fov}: {density:.6g} pixels per degree are more than the "
                f"{_DENSEST} for which quality can be measured; the eye resolves 60"
            )
        least = TUNING_REDUCTION * (2 * SSIM_MARGIN + 1)
        if min(self.width, self.height) < least:
            raise UserError(f"size {self.width} {self.height}: must be at least {least} each to be evaluated")
        foveation = self.frame.foveation
        plain = plain_regions(foveation, (self.height, self.width))
        reduced = self.height // TUNING_REDUCTION, self.width // TUNING_REDUCTION
        found = {f"{name} region": region for name, region in plain.items()}
        half = plain_regions(foveation, reduced, ("foveal",))
        found["foveal region at half the size"] = half["foveal"]
        for name, region in found.items():
            if not region.mask[SSIM_MARGIN:-SSIM_MARGIN, SSIM_MARGIN:-SSIM_MARGIN].any():
                gaze = self.frame.gaze
                raise UserError(
                    f"fov-a {self.frame.fov_a}, fov-b {self.frame.fov_b}, gaze {gaze.x} {gaze.y}, size "
                    f"{self.width} {self.height}: the {name} must have pixels more than {SSIM_MARGIN} from "
                    "the frame's edges, where SSIM is known"
                )
        sides = [side.stop - side.start for side in plain["foveal"].box]
        if min(sides) < _LEAST_CROP:
            raise UserError(
                f"fov-a {self.frame.fov_a}: the fovea is {sides[1]} x {sides[0]} pixels; must be at least "
                f"{_LEAST_CROP} x {_LEAST_CROP} for FovVideoVDP"
            )

    def as_json(self) -> dict[str, Any]:
        """All settings as JSON has them, except for the display."""
        frame, names = self.frame, [field.name for field in fields(self) if field.name != "frame"]
        return {
            "gaze_x": frame.gaze.x,
            "gaze_y": frame.gaze.y,
            "fov_a": frame.fov_a,
            "fov_b": frame.fov_b,
            "spp": frame.spp,
            "acuity_model": frame.acuity_model,
            "integrator": frame.used_integrator.value,
            **{name: getattr(self, name) for name in names},
        }
