"""The controls beside the frame as data: sliders, lists and switches, and what is chosen with them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from compose.eye.acuity import ACUITY_MODELS
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.messages import ShownView

# Ends of the sliders: radii and scale in percent.
_MOST_RADIUS, _MOST_SPP, _LEAST_SCALE, _MOST_RATE = 75, 16, 25, 3
# Ends and default of the target, in frames per second.
_LEAST_FPS, _MOST_FPS, _DEFAULT_FPS = 1, 120, 15
# Speeds of a scene that moves, and steps of its time.
_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
_TIME_STEPS = 1000
_VIEWS, _MODELS = tuple(ShownView), tuple(ACUITY_MODELS)
# What the controller of a target chooses.
_MANUAL = ("samples", "coarsest layer", "finest layer", "finest rate", "scale")
# Controls of time change no setting: the playback is asked.
_TIME = ("play", "speed", "time")
# The ends of ranges, which push each other.
_RANGES = (("fov-b", "fov-a"), ("coarsest layer", "finest layer"))


class Playback:
    """Time of a scene, which goes from 0 to 1 in the given seconds if its speed is 1, while it is playing."""

    def __init__(self, seconds: float):
        self._seconds, self._time, self._before = seconds, 0.0, 0.0
        self.playing, self.speed = False, 1.0

    def at(self, now: float) -> float:
        """The time at `now`, in seconds of a clock that does not go back; after 1 comes 0."""
        if self.playing:
            self._time = (self._time + (now - self._before) * self.speed / self._seconds) % 1
        self._before = now
        return self._time

    def seek(self, time: float) -> None:
        """Goes to a time from 0 to 1."""
        self._time = time


@dataclass(frozen=True)
class Control:
    """A slider from `low` to `high`; a list if it has entries, whose values are their places; or a switch."""

    name: str
    low: int = 0
    high: int = 1
    unit: str = ""
    entries: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """slider, list or switch."""
        if self.entries:
            return "list"
        return "switch" if self.name in ("play", "keep FPS") else "slider"


def _list(name: str, entries: tuple[str, ...]) -> Control:
    return Control(name, 0, len(entries) - 1, "", entries)


class Controls:
    """Values of all controls; what is chosen with them is a valid setting at every moment.

    Until something is changed by hand, the settings are exactly the initial ones, which sliders, with their
    whole numbers, may only approximate; what no control changes stays as it is. The playback is None if the
    scene stands still, which has no controls of time.

    Attributes:
        all: the controls, in the order in which they are shown.
        values: of each, by name.
    """

    def __init__(
        self, settings: FrameSettings, target_fps: float | None, layers: int, playback: Playback | None = None
    ):
        self._initial, self._initial_target, self._playback = settings, target_fps, playback
        self._touched = False
        low, high = settings.layers or (1, layers)
        self._chosen: FrameSettings | None = settings
        initial = {
            _list("view", tuple(view.value for view in _VIEWS)): 0,
            Control("fov-a", 0, _MOST_RADIUS, " %"): round(settings.fov_a),
            Control("fov-b", 0, _MOST_RADIUS, " %"): round(settings.fov_b),
            Control("samples", 1, _MOST_SPP): settings.spp,
            _list("acuity model", _MODELS): _MODELS.index(settings.acuity_model),
            Control("coarsest layer", 1, layers): low,
            Control("finest layer", 1, layers): high,
            Control("finest rate", 0, _MOST_RATE): settings.rate,
            Control("scale", _LEAST_SCALE, 100, " %"): round(100 * settings.scale),
        }
        if playback is not None:
            initial[Control("play")] = int(playback.playing)
            speeds = tuple(f"{speed:g} x" for speed in _SPEEDS)
            initial[_list("speed", speeds)] = _SPEEDS.index(playback.speed)
            initial[Control("time", 0, _TIME_STEPS)] = 0
        initial[Control("keep FPS")] = int(target_fps is not None)
        initial[Control("target", _LEAST_FPS, _MOST_FPS, " FPS")] = round(target_fps or _DEFAULT_FPS)
        self.all = tuple(initial)
        self.values = {one.name: min(max(value, one.low), one.high) for one, value in initial.items()}

    def set(self, name: str, value: int) -> None:
        """Sets a control by hand; ValueError if there is no such control, or it has no such value."""
        control = next((one for one in self.all if one.name == name), None)
        if control is None or type(value) is not int or not control.low <= value <= control.high:
            raise ValueError(f"control {name!r}: cannot be {value!r}")
        if value == self.values[name]:
            return
        self.values[name] = value
        if self._playback is not None and name in _TIME:
            if name == "play":
                self._playback.playing = bool(value)
            elif name == "speed":
                self._playback.speed = _SPEEDS[value]
            else:
                self._playback.seek(value / _TIME_STEPS)
            return
        for lower, upper in _RANGES:
            if name == lower:
                self.values[upper] = max(self.values[upper], value)
            elif name == upper:
                self.values[lower] = min(self.values[lower], value)
        self._touched, self._chosen = True, None

    def set_layers(self, layers: int) -> None:
        """Takes another number of layers; what is chosen stays where it can, and all of them stay all."""
        low, high = self.values["coarsest layer"], self.values["finest layer"]
        high = layers if self._all_layers else min(high, layers)
        names = "coarsest layer", "finest layer"
        self.all = tuple(replace(one, high=layers) if one.name in names else one for one in self.all)
        self.values |= dict(zip(names, (min(low, high), high), strict=True))
        self._chosen = None if self._touched else self._chosen

    def show_time(self, time: float) -> None:
        """Moves the slider of a scene that moves, without seeking the time that it stands for."""
        self.values["time"] = round(time * _TIME_STEPS)

    def text(self, control: Control) -> str:
        """What a control's label says."""
        if control.kind != "slider":
            return control.name
        value = self.values[control.name]
        if control.name == "time":
            return f"time {value / _TIME_STEPS:.2f}"
        return f"{control.name} {value}{control.unit}"

    def is_enabled(self, name: str) -> bool:
        """Whether a control can be changed: not if the target chooses its value."""
        return not (self.values["keep FPS"] and name in _MANUAL)

    def settings(self) -> FrameSettings:
        """The chosen settings; the same object until one of them changes."""
        if self._chosen is None:
            values = self.values
            self._chosen = replace(
                self._initial,
                fov_a=float(values["fov-a"]),
                fov_b=float(values["fov-b"]),
                spp=values["samples"],
                acuity_model=_MODELS[values["acuity model"]],
                layers=None if self._all_layers else (values["coarsest layer"], values["finest layer"]),
                rate=values["finest rate"],
                scale=values["scale"] / 100,
            )
        return self._chosen

    @property
    def target_fps(self) -> float | None:
        """Frames per second to keep; None for no target."""
        if not self._touched:
            return self._initial_target
        return float(self.values["target"]) if self.values["keep FPS"] else None

    @property
    def view(self) -> ShownView:
        """The chosen view."""
        return _VIEWS[self.values["view"]]

    @property
    def _all_layers(self) -> bool:
        most = next(one.high for one in self.all if one.name == "finest layer")
        return (self.values["coarsest layer"], self.values["finest layer"]) == (1, most)
