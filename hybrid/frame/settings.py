"""The settings of one frame: one vocabulary for renderer, window, sweeps, evaluation and command line."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.acuity import DEFAULT_ACUITY_MODEL, acuity_model_named
from compose.eye.display import DISPLAYS, Display, display_named
from compose.eye.gaze import Gaze
from compose.eye.steps import COARSEST_RATE
from compose.fovea.mode import FoveaMode
from compose.fovea.region import Foveation

_CENTRE = Gaze()


@dataclass(frozen=True)
class FrameSettings:
    """How one frame is made.

    The constructor also accepts a pair for the gaze, the name of a fovea mode, and the name or JSON file of a
    display.

    Attributes:
        gaze: where the viewer looks, in fractions of the frame.
        fov_a: radius of the path-traced disc in percent of the frame's height; 0 traces nothing.
        fov_b: radius inside of which no splats are visible, in percent of the height, at most fov_a.
        spp: samples per pixel in the disc.
        fovea: how the disc is made from its samples.
        acuity_model: name of the acuity model (compose.eye.acuity.ACUITY_MODELS).
        layers: coarsest and finest layer that may be drawn, (1, L); None for all.
        rate: finest sampling rate of the periphery, log2 of pixels per sample along each axis.
        scale: side of the rendered frame over that of the camera's, in 0..1.
        display: what the frame is shown on, around its centre.
        camera: the view; None for the scene's own.

    Raises:
        UserError: a value is out of range or unknown.
    """

    gaze: Gaze = _CENTRE
    fov_a: float = 20.0
    fov_b: float = 15.0
    spp: int = 4
    fovea: FoveaMode = FoveaMode.FUSED
    acuity_model: str = DEFAULT_ACUITY_MODEL
    layers: tuple[int, int] | None = None
    rate: int = 0
    scale: float = 1.0
    display: Display = DISPLAYS["desktop"]
    camera: Camera | None = None

    if TYPE_CHECKING:

        def __init__(
            self,
            gaze: Gaze | tuple[float, float] = ...,
            fov_a: float = ...,
            fov_b: float = ...,
            spp: int = ...,
            fovea: FoveaMode | str = ...,
            acuity_model: str = ...,
            layers: tuple[int, int] | None = ...,
            rate: int = ...,
            scale: float = ...,
            display: Display | str = ...,
            camera: Camera | None = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        given: Any = self
        _set(self, "gaze", _gaze(given.gaze))
        _set(self, "fovea", _fovea_mode(given.fovea))
        _set(
            self, "display", display_named(given.display) if isinstance(given.display, str) else given.display
        )
        acuity_model_named(self.acuity_model)
        # Checks the radii.
        _ = self.foveation
        if not isinstance(self.spp, int) or self.spp < 1:
            raise UserError(f"spp {self.spp}: must be a whole number of samples per pixel, 1 or more")
        if not 0 <= self.rate <= COARSEST_RATE:
            raise UserError(f"rate {self.rate}: must be 0 to {COARSEST_RATE}")
        if not 0 < self.scale <= 1:
            raise UserError(f"scale {self.scale}: must be above 0 and at most 1")

    @property
    def foveation(self) -> Foveation:
        """Gaze and radii."""
        return Foveation(self.gaze, self.fov_a, self.fov_b)

    def with_radius(self, fov_a: float) -> FrameSettings:
        """The same with another radius; the band keeps its share of it."""
        share = self.fov_b / self.fov_a if self.fov_a > 0 else 0.0
        return replace(self, fov_a=fov_a, fov_b=share * fov_a)

    def resolved(self, default: Camera) -> tuple[Camera, FrameSettings]:
        """The camera that is rendered, and settings for it in which nothing is left to be looked up.

        At a scale below 1 both the camera and the display have fewer pixels across the same angles.

        Args:
            default: camera of settings that name none.
        """
        camera = self.camera or default
        if self.scale == 1:
            return camera, replace(self, camera=camera)
        camera = camera.resized(*_scaled(self.scale, camera.width, camera.height))
        width, height = _scaled(self.scale, self.display.width, self.display.height)
        display = replace(self.display, width=width, height=height)
        return camera, replace(self, camera=camera, display=display, scale=1.0)

    def as_json(self) -> dict[str, Any]:
        """All settings as JSON has them; equal for equal settings only."""
        return {
            "gaze": [self.gaze.x, self.gaze.y],
            "fov_a": self.fov_a,
            "fov_b": self.fov_b,
            "spp": self.spp,
            "fovea": self.fovea.value,
            "acuity_model": self.acuity_model,
            "layers": None if self.layers is None else list(self.layers),
            "rate": self.rate,
            "scale": self.scale,
            "display": asdict(self.display),
            "camera": None if self.camera is None else self.camera.key.hex(),
        }


def _gaze(given: Gaze | tuple[float, float]) -> Gaze:
    if isinstance(given, Gaze):
        return given
    try:
        return Gaze(*given)
    except (TypeError, ValueError) as error:
        raise UserError(f"gaze {given}: must be two finite numbers, fractions of the frame") from error


def _fovea_mode(given: FoveaMode | str) -> FoveaMode:
    try:
        return FoveaMode(given)
    except ValueError as error:
        names = [mode.value for mode in FoveaMode]
        raise UserError(f"fovea {given}: must be {', '.join(names[:-1])} or {names[-1]}") from error


def _scaled(scale: float, *sides: int) -> tuple[int, ...]:
    return tuple(max(1, round(scale * side)) for side in sides)


def _set(settings: FrameSettings, name: str, value: object) -> None:
    """Replaces a value that was given in another form, before anyone has seen the settings."""
    object.__setattr__(settings, name, value)


# The default of every command, and what other uses change in it.
DEFAULTS = FrameSettings()
# The window: a small disc at the lowest sample count, since samples add up while nothing moves.
INTERACTIVE = FrameSettings(fov_a=15.0, fov_b=11.25, spp=1)
# Evaluations compare methods where samples are scarce.
EVALUATION = FrameSettings(spp=1)
# Sweeps time what Foveated Path Culling times: samples without denoising.
SWEEP = FrameSettings(spp=1, fovea=FoveaMode.RAW)
