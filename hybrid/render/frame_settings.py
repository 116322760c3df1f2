"""The settings of one frame, shared by renderer, window, sweeps, evaluation and command line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from compose.base.errors import UserError, as_plain_numbers
from compose.camera.camera import Camera
from compose.eye.acuity import COARSEST_RATE, DEFAULT_ACUITY_MODEL, acuity_model_named
from compose.eye.display import DISPLAYS, Display, display_named
from compose.eye.gaze import FURTHEST, Gaze
from compose.fovea.foveation import FoveaMode, Foveation, Placement
from pathtrace.trace import Integrator, integrator_named

Given = TypeVar("Given")
Kept = TypeVar("Kept")


class Converted(Generic[Given, Kept]):
    """A dataclass field with a default that converts what the constructor is given, or raises."""

    def __init__(self, convert: Callable[[Given], Kept], default: Kept):
        self._convert, self._default = convert, default

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = f"_{name}"

    def __get__(self, instance: object, owner: type | None = None) -> Kept:
        # Dataclasses read a field's default from the class.
        kept: Kept = self._default if instance is None else instance.__dict__[self._name]
        return kept

    def __set__(self, instance: object, value: Given) -> None:
        instance.__dict__[self._name] = self._convert(value)


# AOVs that frames have if their settings ask for them, since each is rendered apart.
EXTRA_AOVS = "splat", "depth"
# Samples are counted in float32, which holds all whole numbers up to this one.
MOST_SPP = 1 << 24
# Of a continuous level of detail, as in the paper that they are from.
MOST_LEVEL = 100.0
# The quality of what cannot be told from the finest layer.
BEST_JOD = 10.0
# A fused estimate of fewer is hardly better than the splats: fewer cells are traced instead.
_LEAST_SPP_OF_CELLS = 4


def aovs_of_file(path: Path) -> tuple[str, ...]:
    """The AOVs of EXTRA_AOVS that a frame's file can hold: all of them, or none unless it is EXR."""
    return EXTRA_AOVS if path.suffix.lower() == ".exr" else ()


def _gaze(given: Gaze | tuple[float, float]) -> Gaze:
    if isinstance(given, Gaze):
        return given
    try:
        x, y = given
        return Gaze(x, y)
    except (TypeError, ValueError) as error:
        raise UserError(
            f"gaze {given}: must be two finite numbers, fractions of the frame from -{FURTHEST} to {FURTHEST}"
        ) from error


def _fovea_mode(given: FoveaMode | str) -> FoveaMode:
    try:
        return FoveaMode(given)
    except ValueError as error:
        names = [mode.value for mode in FoveaMode]
        raise UserError(f"fovea {given}: must be {', '.join(names[:-1])} or {names[-1]}") from error


def _placement(given: Placement | str) -> Placement:
    try:
        return Placement(given)
    except ValueError as error:
        raise UserError(f"paths {given}: must be {' or '.join(one.value for one in Placement)}") from error


def _integrator(given: Integrator | str | None) -> Integrator | None:
    return None if given is None else integrator_named(given)


def _display(given: Display | str) -> Display:
    return display_named(given) if isinstance(given, str) else given


@dataclass(frozen=True)
class FrameSettings:
    """How one frame is made.

    The constructor also accepts a pair (x, y) as the gaze, the name of a fovea mode or an integrator, and a
    display's name or JSON file.

    Attributes:
        gaze: where the viewer looks, in fractions of the frame.
        fov_a: radius of the path-traced disc in percent of the frame's height; 0 traces nothing.
        fov_b: radius inside which no splats are visible, in percent of the height; at most fov_a.
        spp: samples per pixel in the disc, from 1 to MOST_SPP.
        fovea: how the disc is made from its samples.
        acuity_model: name of the acuity model (compose.eye.acuity.ACUITY_MODELS).
        layers: coarsest and finest layer that may be drawn, from 1 (coarsest) to L; None for all.
        rate: finest sampling rate of the periphery, log2 of pixels per sample along each axis, 0 to 4.
        scale: side of the rendered frame over side of the camera's frame, above 0 and at most 1.
        display: what the frame is shown on, around the display's centre.
        camera: the view; None for the scene's own.
        integrator: how paths are traced; None for unbiased paths in a raw fovea and cached ones in others.
        fill: whether what the forest does not know is path-traced, at a lower resolution.
        time: that the frame shows of a scene that moves, from 0 to 1.
        aovs: which of EXTRA_AOVS are rendered with the frame.
        paths: where they are traced. `where-needed` traces as many as the disc takes, in the cells of the
            frame where the forest expects the most visible errors; not in a raw fovea, whose noise is worse.
        level, gaussians, level_jod: continuous levels of detail in place of layers, of forests in which
            nothing moves; all None for layers. The standard deviation that Gaussians may have, in the finest
            details that the viewer resolves there, over 0 and at most MOST_LEVEL, 1 unless given; how many
            are drawn at most in the periphery, by higher levels all over it; and the quality in JOD against
            the finest layer, over 0 and below 10, down to which levels rise, as far as the forest has learnt
            that for the display.

    Raises:
        UserError: a value is out of range or unknown.
    """

    gaze: Converted[Gaze | tuple[float, float], Gaze] = Converted(_gaze, Gaze())
    fov_a: float = 20.0
    fov_b: float = 15.0
    spp: int = 4
    fovea: Converted[FoveaMode | str, FoveaMode] = Converted(_fovea_mode, FoveaMode.FUSED)
    acuity_model: str = DEFAULT_ACUITY_MODEL
    layers: tuple[int, int] | None = None
    rate: int = 0
    scale: float = 1.0
    display: Converted[Display | str, Display] = Converted(_display, DISPLAYS["desktop"])
    camera: Camera | None = None
    integrator: Converted[Integrator | str | None, Integrator | None] = Converted(_integrator, None)
    fill: bool = True
    time: float = 0.0
    aovs: tuple[str, ...] = ()
    paths: Converted[Placement | str, Placement] = Converted(_placement, Placement.DISC)
    level: float | None = None
    gaussians: int | None = None
    level_jod: float | None = None

    def __post_init__(self) -> None:
        as_plain_numbers(self)
        acuity_model_named(self.acuity_model)
        # Checks the radii.
        _ = self.foveation
        if not isinstance(self.spp, int) or self.spp < 1:
            raise UserError(f"spp {self.spp}: must be a whole number of samples per pixel, 1 or more")
        if self.spp > MOST_SPP:
            raise UserError(f"spp {self.spp}: must be at most {MOST_SPP} samples per pixel")
        if not isinstance(self.rate, int) or not 0 <= self.rate <= COARSEST_RATE:
            raise UserError(f"rate {self.rate}: must be a whole number from 0 to {COARSEST_RATE}")
        if not 0 < self.scale <= 1:
            raise UserError(f"scale {self.scale}: must be above 0 and at most 1")
        if not 0 <= self.time <= 1:
            raise UserError(f"time {self.time:g}: must be from 0 to 1")
        if self.level is not None and not 0 < self.level <= MOST_LEVEL:
            raise UserError(f"level {self.level:g}: must be over 0 and at most {MOST_LEVEL:g}")
        if self.gaussians is not None and (not isinstance(self.gaussians, int) or self.gaussians < 1):
            raise UserError(f"gaussians {self.gaussians}: must be a whole number, 1 or more")
        if self.level_jod is not None and not 0 < self.level_jod < BEST_JOD:
            raise UserError(f"level_jod {self.level_jod:g}: must be over 0 and below {BEST_JOD:g}")
        if unknown := [name for name in self.aovs if name not in EXTRA_AOVS]:
            raise UserError(f"aovs {unknown[0]}: must be of {', '.join(EXTRA_AOVS)}")

    @property
    def used_integrator(self) -> Integrator:
        """How paths are traced, also where the settings leave it open."""
        if self.integrator is not None:
            return self.integrator
        # What is denoised or fused is biased anyway.
        return Integrator.PATH if self.fovea is FoveaMode.RAW else Integrator.CACHED

    @property
    def is_unbiased(self) -> bool:
        """Whether the disc's radiance is the truth on average: raw samples of an unbiased integrator."""
        return self.fovea is FoveaMode.RAW and self.used_integrator.is_unbiased

    @property
    def foveation(self) -> Foveation:
        """Gaze and radii."""
        return Foveation(self.gaze, self.fov_a, self.fov_b)

    @property
    def is_continuous(self) -> bool:
        """Whether levels of detail are continuous."""
        return any(one is not None for one in (self.level, self.gaussians, self.level_jod))

    @property
    def traces_cells(self) -> bool:
        """Whether paths are traced where they are needed, and not in the disc."""
        return self.paths is Placement.WHERE_NEEDED and self.fovea is not FoveaMode.RAW

    @property
    def traced_spp(self) -> int:
        """Samples per pixel where paths are traced: below a few, cells are no better than the splats."""
        return max(self.spp, _LEAST_SPP_OF_CELLS) if self.traces_cells else self.spp

    @property
    def hidden_radius(self) -> float:
        """Radius in percent of the height in which no splats are visible."""
        return 0.0 if self.traces_cells else self.fov_b

    def layers_of(self, count: int) -> tuple[int, int]:
        """Coarsest and finest of `count` layers that may be drawn; UserError if there are no such layers."""
        low, high = self.layers or (1, count)
        if not 1 <= low <= high <= count:
            raise UserError(f"layers {low} {high}: this forest has layers 1 to {count}")
        return low, high

    def with_radius(self, fov_a: float) -> FrameSettings:
        """The same settings with another radius; fov_b keeps its ratio to fov_a."""
        share = self.fov_b / self.fov_a if self.fov_a > 0 else 0.0
        return replace(self, fov_a=fov_a, fov_b=share * fov_a)

    def resolved(self, default: Camera) -> tuple[Camera, FrameSettings]:
        """The camera that is rendered, their own or the default, and the settings with it at a scale of 1.

        At a scale below 1, camera and display have fewer pixels across the same angles.
        """
        camera, display = self.camera or default, self.display
        if self.scale != 1:
            camera = camera.resized(self._scaled(camera.width), self._scaled(camera.height))
            size = {"width": self._scaled(display.width), "height": self._scaled(display.height)}
            display = replace(display, **size)
        return camera, replace(self, camera=camera, display=display, scale=1.0)

    def _scaled(self, side: int) -> int:
        return max(1, round(self.scale * side))

    def as_json(self) -> dict[str, Any]:
        """All settings of the picture, in types that JSON has; equal for equal settings only."""
        plain = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "aovs"}
        return plain | {
            "gaze": [self.gaze.x, self.gaze.y],
            "fovea": self.fovea.value,
            "layers": None if self.layers is None else list(self.layers),
            "display": asdict(self.display),
            "camera": None if self.camera is None else self.camera.key.hex(),
            "integrator": self.used_integrator.value,
            "paths": (Placement.WHERE_NEEDED if self.traces_cells else Placement.DISC).value,
        }


# The defaults of single frames and, below, of other uses.
DEFAULTS = FrameSettings()
# The window: a small disc at the lowest sample count, because samples add up while nothing moves.
INTERACTIVE = FrameSettings(fov_a=15.0, fov_b=11.25, spp=1)
# An evaluation compares methods where samples are scarce.
EVALUATION = FrameSettings(spp=1)
# A sweep times what Foveated Path Culling times: samples without denoising, in the disc alone.
SWEEP = FrameSettings(spp=1, fovea=FoveaMode.RAW, fill=False)
