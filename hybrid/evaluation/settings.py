"""What an evaluation measures."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from compose.base.errors import UserError
from compose.eye.gaze import require_within_frame
from hybrid.frame.settings import EVALUATION, FrameSettings

# References have this many times the samples in the disc, where differences are smallest and most visible.
FOVEAL_REFERENCE = 8


@dataclass(frozen=True)
class EvaluationSettings:
    """What an evaluation measures.

    Attributes:
        frame: settings of the hybrid frames; views set the camera, and methods how the fovea is made.
        width, height: frame size in pixels.
        views: number of views.
        reference_spp: samples per pixel of the references; FOVEAL_REFERENCE times as many in the disc.
        repeats: timed frames per method.
        seed: same seed, same quality on the same machine.

    Raises:
        UserError: a count or a size is not positive, the gaze lies outside the frame, or there is no disc.
    """

    frame: FrameSettings = EVALUATION
    width: int = 512
    height: int = 512
    views: int = 5
    reference_spp: int = 32
    repeats: int = 300
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("width", "height", "views", "reference_spp", "repeats"):
            if getattr(self, name) <= 0:
                raise UserError(f"{name.replace('_', '-')} {getattr(self, name)}: must be positive")
        require_within_frame(self.frame.gaze.x, self.frame.gaze.y)
        if self.frame.fov_a == 0:
            raise UserError("fov-a 0.0: there is no fovea to evaluate")

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
