"""What is evaluated, and how."""

from __future__ import annotations

from dataclasses import dataclass

from compose.base.errors import UserError
from compose.eye.gaze import Gaze, require_within_frame
from compose.fovea.region import Foveation

# Where differences are smallest, and the viewer sees them best, a reference has so many times the samples.
FOVEAL_REFERENCE = 8


@dataclass(frozen=True)
class EvaluationSettings:
    """What is evaluated.

    Attributes:
        width, height: frame size in pixels.
        views: how many are measured.
        gaze_x, gaze_y: in fractions of the frame, the same in all views.
        fov_a, fov_b: radii in percent of the height.
        spp: samples per pixel in the disc.
        reference_spp: samples per pixel of the references, FOVEAL_REFERENCE times as many in the disc.
        repeats: frames timed per method.
        seed: same seed, same quality on the same machine.

    Raises:
        UserError: the gaze lies outside of the frame, or a radius is wrong.
    """

    width: int = 512
    height: int = 512
    views: int = 5
    gaze_x: float = 0.5
    gaze_y: float = 0.5
    fov_a: float = 20.0
    fov_b: float = 15.0
    spp: int = 1
    reference_spp: int = 32
    repeats: int = 300
    seed: int = 0

    def __post_init__(self) -> None:
        require_within_frame(self.gaze_x, self.gaze_y)
        if self.foveation.fov_a == 0:
            raise UserError("--fov-a 0.0: there is no fovea to evaluate")

    @property
    def gaze(self) -> Gaze:
        return Gaze(self.gaze_x, self.gaze_y)

    @property
    def foveation(self) -> Foveation:
        return Foveation(self.gaze, self.fov_a, self.fov_b)
