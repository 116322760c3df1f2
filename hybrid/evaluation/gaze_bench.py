"""How good methods are for a viewer who looks around while they know the gaze late and inexactly.

Clips are judged as videos where the viewer really looks (FovVideoVDP, a fixation in each frame).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera, View, eyes
from compose.eye.display import Display
from compose.eye.gaze import AngularTrace, Gaze, GazeTrace, simulated
from compose.image.colour import Image
from hybrid.base.cache_folder import scene_folder
from hybrid.base.identity import Journal, measured_identity, short_hash
from hybrid.base.progress import Steps
from hybrid.evaluation.baselines_traced import FullTrace
from hybrid.evaluation.moving_bench import BETWEEN_EYES, HYBRID, SPLATS, TRACED
from hybrid.evaluation.temporal_baselines import Svgf, TemporalAntialiasing, TracedFrame
from hybrid.evaluation.verdicts import mean_interval
from hybrid.measure.flicker import added_flicker
from hybrid.measure.perceptual_metrics import jod, jod_of_video
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.render.frame_renderer import LiveRenderer, Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.splat_renderer import SplatRenderer
from hybrid.render.video import ViewPath
from pathtrace.region.neighbourhood import Neighbourhood
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator
from splat.model.forest import Forest

STILL, TAA, SVGF = "hybrid, still", "TAA", "SVGF"
# Frames before each clip, neither judged nor timed: what histories know when a clip begins.
_LEAD_IN = 8
# Seconds of a walk once around the neighbourhood of the scene's camera, and views from one to the next of
# which it goes straight.
_ROUND, _STOPS = 8.0, 32
# Of a tracker's error: shares of its size that stay, and that turn around once in so many seconds.
_OFFSET, _DRIFT, _TURN = 0.8, 0.6, 3.0
# Farthest from straight ahead, in degrees, that a tracker says somebody looks.
_MOST_DEGREES = 85.0
# Degrees from the gaze up to which JOD is that of the fovea.
_FOVEA = 5.0
# Frames have seeds of their own in each clip.
_SEEDS = 100_000


@dataclass(frozen=True)
class Clips:
    """What is shown: so many clips, how long each, at how many frames per second, and how finely referenced.

    A clip is of both eyes, apart like a viewer's, if `both_eyes`; if `walks`, the camera moves.
    """

    count: int
    seconds: float
    fps: int
    reference_spp: int
    walks: bool = False
    both_eyes: bool = False

    @property
    def frames(self) -> int:
        """Number of judged frames of a clip, at least 2."""
        return max(2, round(self.seconds * self.fps))


@dataclass(frozen=True)
class Tracking:
    """What a renderer knows of the gaze: that of so many milliseconds ago, wrong by so many degrees (rms).

    The error is that of eye trackers: most of it a constant offset, and a slow drift. In a direction chosen
    by a seed, 0.8 of it stays; 0.6 of it turns around once in three seconds. Errors of all sizes go the same
    way.
    """

    latency_ms: float
    error_deg: float

    def at(self, trace: GazeTrace, seconds: float, display: Display, seed: int) -> Gaze:
        """The gaze that the renderer has at a time of a trace."""
        seconds -= self.latency_ms / 1000
        gaze = trace.at(seconds)
        if self.error_deg == 0:
            return gaze
        start, first = np.random.default_rng(seed).uniform(0, 2 * np.pi, 2)
        turns = np.array([start, first + 2 * np.pi * seconds / _TURN])
        error = np.array([_OFFSET, _DRIFT]) @ np.stack([np.cos(turns), np.sin(turns)], axis=1)
        size = np.array([display.width, display.height])
        # In angles of the display's plane.
        offset = (np.array([gaze.x, gaze.y]) - 0.5) * size / display.focal
        degrees = np.degrees(np.arctan(offset)) + self.error_deg * error
        degrees = np.clip(degrees, -_MOST_DEGREES, _MOST_DEGREES)
        x, y = (0.5 + display.focal * np.tan(np.radians(degrees)) / size).tolist()
        return Gaze(x, y)


def bench_gaze(
    scene: Scene,
    forest: Forest,
    settings: FrameSettings,
    clips: Clips,
    trace: GazeTrace | AngularTrace | None,
    tracked: tuple[Sequence[float], Sequence[float]],
    write: Callable[[list[dict[str, Any]]], None],
    progress: Steps,
) -> list[dict[str, Any]]:
    """One row per method and, if it follows the gaze, latency and error; resumes if interrupted.

    Frames are as large as the settings' display. The gaze is that of a trace, or of a simulated viewer;
    `tracked` are latencies in milliseconds and errors in degrees, each of the former with each of the latter.
    Rows are written before the intermediate results are deleted.

    Rows have method, latency_ms and gaze_error_deg (None if the method does not follow the gaze); jod of the
    whole video and foveal_jod, means over the clips, with low and high, foveal_low and foveal_high, their 95
    % intervals over the clips, and both by clip, which methods share; each None if unknown; flicker, in
    thresholds of the eye (`added_flicker`); ms, the median over all frames; width and height of the display;
    clips and frames of each. UserError if the trace is too short, or nobody can walk.
    """
    trackings = [Tracking(*pair) for pair in product(*tracked)]
    longest, display = max(one.latency_ms for one in trackings) / 1000, settings.display
    trace = trace_of(trace, clips, longest, display)
    bench = _Bench(scene, forest, settings, clips, trace)
    given = {"settings": settings.as_json(), "clips": asdict(clips), "gaze": trace.digest()}
    identity = measured_identity(scene, forest, longest=longest, **given)
    file = scene_folder(scene.name, scene.hash) / f"gaze-{short_hash(identity)}.json"
    journal = Journal(file, identity)
    of = {name: trackings if method.follows else [None] for name, method in bench.methods.items()}
    jobs = [(name, one) for name, known in of.items() for one in known]
    starts = starts_of(trace, clips, longest)
    found: dict[tuple[str, Tracking | None], list[dict[str, Any]]] = {job: [] for job in jobs}
    for number, start in enumerate(starts):
        for place, (name, one) in enumerate(jobs):
            progress(number * len(jobs) + place, len(starts) * len(jobs))
            key = f"{number} {name} {one}"
            if key not in journal:
                journal[key] = bench.judged(name, one, number, start)
            found[name, one].append(journal[key])
    progress(1, 1)
    common = {"width": display.width, "height": display.height, "clips": clips.count, "frames": clips.frames}
    rows = [
        {
            "method": name,
            "latency_ms": None if one is None else one.latency_ms,
            "gaze_error_deg": None if one is None else one.error_deg,
            **_summary(results),
            **common,
        }
        for (name, one), results in found.items()
    ]
    write(rows)
    journal.remove()
    return rows


def trace_of(
    trace: GazeTrace | AngularTrace | None, clips: Clips, longest: float, display: Display
) -> GazeTrace:
    """The trace on a display, or a simulated viewer's; UserError if it is shorter than a clip."""
    lead, length = _LEAD_IN / clips.fps + longest, clips.frames / clips.fps
    if trace is None:
        seconds = lead + length + (clips.count - 1) * (lead + length) + 1
        return simulated(display, display.width, display.height, seconds, seed=0)
    found = trace.on(display, display.width, display.height)
    if found.duration < lead + length:
        raise UserError(f"gaze trace of {found.duration:g} s: must be of {lead + length:.2f} s at least")
    return found


def starts_of(trace: GazeTrace, clips: Clips, longest: float) -> list[float]:
    """When in the trace clips begin, in seconds: all over it, behind what the longest latency shows."""
    first, last = _LEAD_IN / clips.fps + longest, trace.duration - clips.frames / clips.fps
    return [float(start) for start in np.linspace(first, last, clips.count)]


def foveal_jod(
    images: Sequence[Image], truths: Sequence[Image], gazes: Sequence[Gaze], display: Display
) -> float | None:
    """JOD of what lies around the gaze, in a square of ten degrees, as single images; mean over frames.

    JOD of a whole video averages over the frame, of which the fovea is a small part. None if unknown.
    """
    size = np.array(images[0].shape[1::-1])
    box = np.minimum(round(2 * _FOVEA * display.pixels_per_degree), size)
    scores = []
    for image, truth, gaze in zip(images, truths, gazes, strict=True):
        # Within the frame, also where the gaze is at its edge.
        at = np.array([gaze.x, gaze.y]) * size
        left, top = corner = np.clip(np.rint(at - box / 2), 0, size - box).astype(int)
        part = np.s_[top : top + box[1], left : left + box[0]]
        scores.append(jod(image[part], truth[part], display, Gaze(*((at - corner) / box).tolist())))
    return _mean(scores)


@dataclass(frozen=True)
class _Method:
    """Makes frames that follow each other from camera, gaze, number and seed; `follows` if by the gaze."""

    frame: Callable[[Camera, Gaze, int, int], Image]
    forget: Callable[[], None]
    follows: bool = False


class _Bench:
    """Clips by methods."""

    def __init__(self, scene: Scene, forest: Forest, settings: FrameSettings, clips: Clips, trace: GazeTrace):
        self._settings, self._clips, self._trace = settings, clips, trace
        live, still = LiveRenderer(scene, forest), Renderer(scene, forest)
        self._tracer = still.tracer
        size = settings.display.width, settings.display.height
        self._near = Neighbourhood(live.scene, live.scene.surfaces(), *size)
        self._truths: dict[Camera, Image] = {}
        stops = self._near.path(np.linspace(0, 1, _STOPS + 1).tolist())
        self._way = ViewPath([View(camera) for camera in stops])
        if clips.walks and all(camera == self._near.home for camera in stops):
            raise UserError(f"{scene.name}: around the scene's camera there is no free space to walk in")
        splats, traced = SplatRenderer(forest), FullTrace(live.tracer_of(Integrator.CACHED), 1, denoised=True)

        def settings_at(camera: Camera, gaze: Gaze) -> FrameSettings:
            return replace(settings, camera=camera, gaze=gaze)

        def temporal(made: Svgf | TemporalAntialiasing) -> _Method:
            tracer = traced.tracer
            return _Method(
                lambda camera, gaze, number, seed: made.frame(TracedFrame.of(tracer, camera, number, seed)),
                made.forget,
            )

        self.methods = {
            HYBRID: _Method(
                lambda camera, gaze, number, seed: live.frame(settings_at(camera, gaze), seed).composite,
                live.forget,
                follows=True,
            ),
            STILL: _Method(
                lambda camera, gaze, number, seed: still.frame(settings_at(camera, gaze), seed).composite,
                still.forget,
                follows=True,
            ),
            SPLATS: _Method(
                lambda camera, gaze, number, seed: splats.splats(settings_at(camera, gaze)), lambda: None
            ),
            TRACED: _Method(
                lambda camera, gaze, number, seed: traced.render(View(camera), gaze, seed).image, lambda: None
            ),
            TAA: temporal(TemporalAntialiasing()),
            SVGF: temporal(Svgf()),
        }

    def judged(self, name: str, tracking: Tracking | None, number: int, start: float) -> dict[str, Any]:
        """Quality, flicker and milliseconds of a clip, means over the eyes."""
        display, fps = self._settings.display, self._clips.fps
        scores: dict[str, list[float | None]] = {"jod": [], "foveal_jod": [], "flicker": []}
        milliseconds: list[float] = []
        seconds = [start + frame / fps for frame in range(self._clips.frames)]
        gazes = [self._trace.at(second) for second in seconds]
        for cameras in self._eyes(start):
            images, times = self._shown(self.methods[name], tracking, number, start, cameras)
            truths = [self._truth(camera) for camera in cameras[_LEAD_IN:]]
            scores["jod"].append(jod_of_video(images, truths, fps, display, gazes))
            scores["foveal_jod"].append(foveal_jod(images, truths, gazes, display))
            scores["flicker"].append(added_flicker(images, truths, gazes, fps, display))
            milliseconds += times
        return {name: _mean(of) for name, of in scores.items()} | {"ms": milliseconds}

    def _shown(
        self,
        method: _Method,
        tracking: Tracking | None,
        number: int,
        start: float,
        cameras: Sequence[Camera],
    ) -> tuple[list[Image], list[float]]:
        """The judged frames of a clip by a method, from one eye's cameras, and their milliseconds."""
        images, milliseconds = [], []
        method.forget()
        for frame, camera in enumerate(cameras):
            gaze = Gaze()
            if tracking is not None:
                second = start + (frame - _LEAD_IN) / self._clips.fps
                gaze = tracking.at(self._trace, second, self._settings.display, number)
            begin = time.perf_counter()
            image = method.frame(camera, gaze, frame, number * _SEEDS + frame)
            if frame >= _LEAD_IN:
                milliseconds.append((time.perf_counter() - begin) * 1000)
                images.append(image)
        return images, milliseconds

    def _eyes(self, start: float) -> Iterator[list[Camera]]:
        """The cameras of a clip's frames, the lead-in before them, of one eye or both."""
        count = _LEAD_IN + self._clips.frames
        cameras = [self._near.home] * count
        if self._clips.walks:
            times = start + (np.arange(count) - _LEAD_IN) / self._clips.fps
            cameras = [self._way.at(share).camera for share in times / _ROUND % 1]
        if not self._clips.both_eyes:
            yield cameras
            return
        pairs = [eyes(camera, BETWEEN_EYES * self._near.scale) for camera in cameras]
        yield from ([pair[eye] for pair in pairs] for eye in range(2))

    def _truth(self, camera: Camera) -> Image:
        if camera not in self._truths:
            # As many as two eyes see in a clip.
            if len(self._truths) >= 2 * self._clips.frames:
                self._truths.clear()
            spp = self._clips.reference_spp
            self._truths[camera] = reference(self._tracer, camera, spp, REFERENCE_SEED).radiance
        return self._truths[camera]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _summary(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means over clips, 95 % intervals of JOD, and the median time of all frames."""
    row: dict[str, Any] = {}
    for name, low, high in (("jod", "low", "high"), ("foveal_jod", "foveal_low", "foveal_high")):
        scores = [result[name] for result in results]
        known = [score for score in scores if score is not None]
        row |= {name: _mean(scores), low: None, high: None, f"{name}_by_clip": scores}
        if len(known) > 1:
            row |= dict(zip((name, low, high), mean_interval(known, 0.95), strict=True))
    return {
        **row,
        "flicker": _mean([result["flicker"] for result in results]),
        "ms": float(np.median([ms for result in results for ms in result["ms"]])),
    }
