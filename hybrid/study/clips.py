"""The stimuli of a study, rendered before it is run, so that no condition is late.

Each condition is a method of rendering with its settings. All conditions of a scene show the same views, for
a viewer who looks at the cross.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PillowImage

from compose.base.errors import UserError, one_line
from compose.base.files import json_text, read_json, whole_folder, write_text
from compose.camera.camera import View
from compose.eye.gaze import Gaze, GazeTrace
from compose.image.colour import Image, bytes_from_radiance
from hybrid.base.identity import measured_identity, require_same
from hybrid.base.progress import Bar, interrupts_between_steps
from hybrid.evaluation.baselines_traced import FullTrace
from hybrid.evaluation.methods import HybridMethod, Method
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.image_files import write_srgb
from hybrid.render.video import ViewPath
from hybrid.study.design import ANCHOR, REFERENCE, Clip, StudyMethod, Timing
from pathtrace.region.neighbourhood import unseen_views
from pathtrace.trace import Integrator

CLIPS = "clips"
# What checks attention is the reference with pixels this many times as large: nobody takes it for the others.
_COARSER = 32
# Settings that the design itself chooses.
_CHOSEN = {"gaze", "camera", "time", "display", "aovs"}
# Bytes of a clip's name; numbers come first, so that a cut one is still unique.
_LONGEST_NAME = 200
_METHODS = REFERENCE, "hybrid", "full"
Conditions = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Preset:
    """What a published study had: its method, timing and repetitions, conditions, and number of views."""

    method: StudyMethod
    conditions: Conditions
    timing: Timing = field(default_factory=Timing)
    repeats: int = 1
    views: int = 1
    observers: int = 15


_TRUTH: Conditions = {REFERENCE: {"method": REFERENCE}}
# Splats alone, with levels of detail.
_FOVEATED: dict[str, Any] = {"method": "hybrid", "fov_a": 0.0}
_COMPARED: Conditions = {
    **_TRUTH,
    "hybrid": {"method": "hybrid"},
    "all splats": {**_FOVEATED, "acuity_model": "none"},
    "foveated splats": _FOVEATED,
}
PRESETS = {
    # Five views, each three times (Foveated Path Culling, section 5).
    "fpc": Preset(
        StudyMethod.DSIS,
        {**_TRUTH, "hybrid": {"method": "hybrid", "fovea": "raw"}},
        repeats=3,
        views=5,
        observers=11,
    ),
    # Ground truth, theirs, all Gaussians at full rate, and levels of detail alone (Fov-GS, section 5).
    "fov-gs": Preset(
        StudyMethod.GRADED,
        {**_COMPARED, "foveated splats": {**_FOVEATED, "acuity_model": "fov-gs"}},
        Timing(stimulus=8.0, answer=None, rest=10.0),
    ),
    # Against all Gaussians and foveated ones (perceptually guided continuous level of detail, section 4).
    "pairs": Preset(StudyMethod.PAIRS, _COMPARED, Timing(answer=None)),
}


@dataclass(frozen=True)
class Presentation:
    """How a study's stimuli are made, of all scenes.

    Attributes:
        kind: still, trace (the gaze follows one), walk (between views) or play (a moving scene).
        seconds, fps: of videos.
        frame: size in pixels and display are those of this, and the gaze is, unless it follows a trace.
        views: unseen ones of each scene.
        spp: samples per pixel of references.
        seed: of the first frame.
    """

    kind: str
    seconds: float
    fps: int
    size: tuple[int, int]
    frame: FrameSettings
    trace: GazeTrace | None = None
    views: int = 1
    spp: int = 256
    seed: int = 0

    def shown(self, views: Sequence[View], number: int, loop: float | None) -> list[tuple[View, Gaze]]:
        """Views and gazes of the frames of a scene's view; a scene's loop, if it moves, takes seconds."""
        count = 1 if self.kind == "still" else max(1, round(self.seconds * self.fps))
        view, found = views[number], []
        path = ViewPath([view, views[(number + 1) % len(views)]]) if self.kind == "walk" else None
        for frame in range(count):
            seconds = frame / self.fps
            gaze = self.frame.gaze if self.trace is None else self.trace.at(seconds)
            at = view if path is None else path.at(frame / max(1, count - 1))
            if self.kind == "play" and loop is not None:
                at = replace(at, time=(at.time + seconds / loop) % 1)
            found.append((at, gaze))
        return found


def load_conditions(path: Path) -> Conditions:
    """Conditions by name from a JSON file, one of them the reference; UserError if they cannot be rendered.

    Each has a `method`, and settings of frames. Methods are reference, hybrid (splats alone with a fov_a of
    0), and full (paths everywhere, with `spp`, `denoised` or not).
    """
    try:
        found = read_json(path)
        if not isinstance(found, dict) or len(found) < 2:
            raise ValueError("must be an object of two conditions or more, by name")
        for name, settings in found.items():
            if not isinstance(settings, dict):
                raise ValueError(f"{name}: must be an object with a method")
            _check(name, settings)
        if found.get(REFERENCE, {}).get("method") != REFERENCE:
            raise ValueError("must have a condition named reference, of that method")
        return found
    except (OSError, TypeError, ValueError, UserError) as error:
        raise UserError(f"{path}: {one_line(error)}") from error


def _check(name: str, settings: dict[str, Any]) -> None:
    """TypeError, ValueError or UserError unless a condition can be rendered."""
    method = settings.get("method", "hybrid")
    if method not in _METHODS:
        raise ValueError(f"{name}: method {method} must be one of {', '.join(_METHODS)}")
    if name == ANCHOR:
        raise ValueError(f"{name}: is the name of what checks attention; choose another")
    known = {one.name for one in fields(FrameSettings)} - _CHOSEN if method == "hybrid" else set()
    known |= {"spp", "denoised"} if method == "full" else set()
    if unknown := sorted(set(settings) - known - {"method"}):
        raise ValueError(f"{name}: method {method} has no setting {unknown[0]}")
    try:
        _settings_of(FrameSettings(), settings)
    except TypeError as error:
        raise ValueError(f"{name}: {', '.join(settings)}: {one_line(error)}") from error


def _settings_of(frame: FrameSettings, settings: dict[str, Any]) -> FrameSettings:
    """The frame settings of a condition; without a fov_b, that keeps its ratio to fov_a."""
    own = {name: value for name, value in settings.items() if name not in ("method", "denoised")}
    if own.get("layers") is not None:
        own["layers"] = tuple(own["layers"])
    if "fov_a" in own:
        own.setdefault("fov_b", frame.with_radius(own["fov_a"]).fov_b)
    return replace(frame, **own)


class Stimuli:
    """Renders the clips of one scene with its forest into a study's folder.

    Clips that are complete stay, so that interrupted work resumes. UserError if the folder holds other ones.
    """

    def __init__(self, folder: Path, renderer: Renderer, conditions: Conditions, presentation: Presentation):
        self._folder, self._renderer = folder / CLIPS, renderer
        self._conditions, self._presentation = conditions, presentation
        scene, forest = renderer.scene, renderer.periphery.forest
        shown = presentation
        settings = {
            "conditions": conditions,
            "frame": shown.frame.as_json(),
            "trace": None if shown.trace is None else shown.trace.digest(),
            "shown": [shown.kind, shown.seconds, shown.fps, shown.views, shown.spp, shown.seed],
            "size": list(shown.size),
        }
        self._identity = measured_identity(scene, forest, **settings)

    def needs_irradiance(self) -> bool:
        """Whether a condition ends paths in known irradiance."""
        hybrid = (one for one in self._conditions.values() if one.get("method", "hybrid") == "hybrid")
        frames = (_settings_of(self._presentation.frame, one) for one in hybrid)
        return any(one.used_integrator is Integrator.CACHED and one.fov_a > 0 for one in frames)

    def render(self, bar: Bar) -> dict[str, list[Clip]]:
        """The clips, the anchor last, by what they show, such as "room view 1"."""
        scene, shown = self._renderer.scene, self._presentation
        loop = None if scene.moving is None else scene.moving.motion.seconds
        if shown.kind == "play" and loop is None:
            raise UserError(f"stimulus play: scene {scene.name} does not move")
        self._check()
        # A walk needs another view to go to.
        around = unseen_views(scene, max(2, shown.views), *shown.size)
        frames = [shown.shown(around, number, loop) for number in range(shown.views)]
        self._total, self._done = len(self._conditions) * sum(map(len, frames)), 0
        bar(0, self._total)
        found = {}
        with interrupts_between_steps() as interrupted:
            for number, each in enumerate(frames):
                gazes = [gaze for _, gaze in each]
                clips = {name: self._clip(number, name, gazes) for name in self._conditions}
                for name, clip in clips.items():
                    if not (self._folder / clip.name).is_dir():
                        self._write(clip, self._images(self._conditions[name], each), bar, interrupted)
                    self._done += clip.frames
                    bar(self._done, self._total)
                anchor = self._anchor(number, clips[REFERENCE])
                found[f"{scene.name} view {number + 1}"] = [*clips.values(), anchor]
        return found

    def _write(self, clip: Clip, images: Iterator[Image], bar: Bar, interrupted: Callable[[], None]) -> None:
        with whole_folder(self._folder / clip.name, _file(clip.frames - 1)) as part:
            for frame, image in enumerate(images):
                write_srgb(part / _file(frame), bytes_from_radiance(image))
                bar(self._done + frame + 1, self._total)
                interrupted()

    def _check(self) -> None:
        """Refuses clips that were rendered of something else."""
        file = self._folder / f"{self._renderer.scene.name}.json"
        if file.exists():
            try:
                found = read_json(file)
            except (OSError, ValueError) as error:
                raise UserError(f"{file}: is damaged ({one_line(error)}); delete {self._folder}") from error
            said = f"{self._folder}: holds other clips"
            require_same(found, self._identity, said, "delete it, or name another folder")
        write_text(file, json_text(self._identity))

    def _clip(self, view: int, condition: str, gazes: list[Gaze]) -> Clip:
        # A trace may look beside the frame.
        places = np.clip([(gaze.x, gaze.y) for gaze in (gazes if len(set(gazes)) > 1 else gazes[:1])], 0, 1)
        marker = tuple((float(x), float(y)) for x, y in places)
        return Clip(self._name(view, condition), condition, len(gazes), float(self._presentation.fps), marker)

    def _name(self, view: int, condition: str) -> str:
        """The name of a clip's folder, which is a part of addresses as well; unique whatever others are."""
        scene = self._renderer.scene
        number = [*self._conditions, ANCHOR].index(condition)
        name = f"{scene.hash[:6]}-v{view + 1}-{number}-{scene.name}-{condition}"
        return "".join(c if c.isalnum() and c.isascii() else "-" for c in name)[:_LONGEST_NAME]

    def _images(self, settings: dict[str, Any], frames: list[tuple[View, Gaze]]) -> Iterator[Image]:
        """The frames of a condition, (H, W, 3) linear radiance each."""
        renderer, shown, kind = self._renderer, self._presentation, settings.get("method", "hybrid")
        method: Method | None = None
        if kind == "full":
            method = FullTrace(renderer.tracer, settings.get("spp", 4), bool(settings.get("denoised", True)))
        elif kind == "hybrid":
            method = HybridMethod(renderer, _settings_of(shown.frame, settings))
        # No frame of another condition or view is part of these.
        renderer.forget()
        for seed, (view, gaze) in enumerate(frames, shown.seed):
            if method is not None:
                yield method.render(view, gaze, seed).image
            else:
                renderer.scene.show(view.time)
                yield reference(renderer.tracer, view.camera, shown.spp, REFERENCE_SEED + seed).radiance

    def _anchor(self, view: int, of: Clip) -> Clip:
        clip = replace(of, name=self._name(view, ANCHOR), condition=ANCHOR)
        if not (self._folder / clip.name).is_dir():
            with whole_folder(self._folder / clip.name, _file(clip.frames - 1)) as part:
                for frame in range(clip.frames):
                    with PillowImage.open(self._folder / of.name / _file(frame)) as image:
                        few = [max(1, side // _COARSER) for side in image.size]
                        coarse = image.resize(few, PillowImage.Resampling.BOX).resize(image.size)
                    write_srgb(part / _file(frame), np.asarray(coarse))
        return clip


def _file(frame: int) -> str:
    return f"{frame:06}.png"
