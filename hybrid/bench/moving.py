"""How well and how fast methods show a scene that plays, as in the window, region by region."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.image.colour import Image, luminance, srgb_from_radiance
from hybrid.evaluation.equal_time import at_equal_time
from hybrid.evaluation.families import enlarged
from hybrid.frame.live import LiveRenderer
from hybrid.frame.settings import FrameSettings
from hybrid.measure.metrics.psnr import psnr_of_error
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.measure.regions import regions
from hybrid.measure.timing import percentiles, ratio_of_medians
from hybrid.methods.hybrid import HybridMethod
from hybrid.methods.method import Method
from pathtrace.scene.moving import MovingScene
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.integrator import Integrator
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest

HYBRID, ALONE, SPLATS, TRACED = "hybrid", "hybrid, no history", "splats alone", "path-traced, denoised"
# Clips, spread over the time of the scene; frames of each, of which the last is judged; and of a second.
_CLIPS, _FRAMES, _FRAMES_PER_SECOND = 6, 8, 13.0
# Frames before the last one in which something else was at the place of what has just been uncovered.
_UNCOVERED = 4
# Relative change of luminance over these frames from which on a still surface counts as in a moving shadow.
_SHADOW = 0.05
_DARK = 1e-3
# Frames of a clip that are not timed: the first ones wait for kernels.
_WARM_UP = 2
# Paths per pixel of the path-traced frames, from which their number at equal time is sought.
_RAYS = 0.25


def bench_moving(
    scene: Scene,
    forest: Forest,
    settings: FrameSettings,
    reference_spp: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per method and region of a scene that plays, with the gaze on what moves most visibly.

    Args:
        scene, forest: what is rendered; the scene moves.
        settings: of the frames, apart from gaze and time; with its camera.
        reference_spp: samples per pixel of the references.
        progress: called with clips done and clips in total.

    Returns:
        Rows of `method`, `region`, `psnr` of the pixels of all clips together, `ms` per frame (`p50`, `p95`)
        and `ratio`, the hybrid's median over the method's. Path-traced frames are denoised, and of so many
        pixels that they take as long as the hybrid's; they are left out if the smallest takes longer.

    Raises:
        UserError: nothing moves in the scene, or nothing that moves is ever seen.
    """
    moving = require_moving(scene)
    camera, _ = settings.resolved(scene.camera)
    renderer = LiveRenderer(scene, forest)
    methods = _Methods(renderer, replace(settings, camera=camera))
    errors: dict[tuple[str, str], list[NDArray[np.float32]]] = {}
    times: dict[str, list[float]] = {}
    for number in range(_CLIPS):
        clip = _clip(renderer.tracer, moving, camera, number, reference_spp)
        for method, shown in methods.played(clip).items():
            times.setdefault(method, []).extend(shown.milliseconds)
            squares = _squares(shown.image, clip.truth)
            for region, mask in clip.regions(settings).items():
                errors.setdefault((method, region), []).append(squares[mask])
        progress(number + 1, _CLIPS)
    return [
        {
            "method": method,
            "region": region,
            "psnr": psnr_of_error(float(np.mean(np.concatenate(found), dtype=np.float64))),
            "pixels": int(sum(map(len, found))),
            "ms": percentiles(times[method], (50, 95)),
            "ratio": ratio_of_medians(times[HYBRID], times[method]),
        }
        for (method, region), found in errors.items()
        if sum(map(len, found))
    ]


# From settings with their time, and a seed, to a frame.
_Frame = Callable[[FrameSettings, int], Image]


@dataclass(frozen=True)
class _Clip:
    """A few frames of a scene that plays, and the truth of the last one.

    Attributes:
        times: (T,) of the frames, from 0 to 1.
        gaze: on what moves.
        truth: (H, W, 3) reference radiance.
        moves, uncovered, shadow: (H, W) what moves; what stands still and was hidden by what moves; and what
            stands still, was not hidden, and has another luminance than a few frames before.
    """

    times: Sequence[float]
    gaze: Gaze
    truth: Image
    moves: NDArray[np.bool_]
    uncovered: NDArray[np.bool_]
    shadow: NDArray[np.bool_]

    def regions(self, settings: FrameSettings) -> dict[str, NDArray[np.bool_]]:
        """Masks (H, W) by name."""
        found = regions(replace(settings, gaze=self.gaze).foveation, self.truth)
        return {name: found[name].mask for name in ("whole", "foveal", "salient")} | {
            "moving": self.moves,
            "uncovered": self.uncovered,
            "shadow": self.shadow,
        }


@dataclass(frozen=True)
class _Shown:
    """The last frame of a clip (H, W, 3), and milliseconds of those that are timed."""

    image: Image
    milliseconds: list[float]


class _Methods:
    """Methods that show a clip.

    Args:
        renderer: of the scene.
        settings: of the frames.
    """

    def __init__(self, renderer: LiveRenderer, settings: FrameSettings):
        self._renderer, self._settings = renderer, settings
        self._traced = self._as_slow()

    def played(self, clip: _Clip) -> dict[str, _Shown]:
        """The clip by each method in turn."""
        self._renderer.forget()
        methods = {
            HYBRID: self._frame,
            ALONE: self._fresh_frame,
            SPLATS: lambda settings, seed: self._renderer.splats(settings),
        }
        if self._traced is not None:
            methods[TRACED] = partial(self._traced_frame, self._traced)
        return {name: self._timed(clip, method) for name, method in methods.items()}

    def _timed(self, clip: _Clip, method: _Frame) -> _Shown:
        milliseconds, image = [], None
        for number, at in enumerate(clip.times):
            settings = replace(self._settings, time=at, gaze=clip.gaze)
            start = time.perf_counter()
            image = method(settings, number)
            milliseconds.append((time.perf_counter() - start) * 1000)
        assert image is not None
        return _Shown(image, milliseconds[_WARM_UP:])

    def _frame(self, settings: FrameSettings, seed: int) -> Image:
        return self._renderer.frame(settings, seed).composite

    def _fresh_frame(self, settings: FrameSettings, seed: int) -> Image:
        self._renderer.forget()
        return self._frame(settings, seed)

    def _traced_frame(self, traced: Method, settings: FrameSettings, seed: int) -> Image:
        assert settings.camera is not None
        self._renderer.scene.set_time(settings.time)
        return traced.render(settings.camera, settings.gaze, seed).image

    def _as_slow(self) -> Method | None:
        """Path-traced frames that take as long as the hybrid's; None if none do."""
        tracer = self._renderer.tracer_of(Integrator.CACHED)
        family = partial(enlarged, tracer, 1, denoised=True)
        ours = HybridMethod(self._renderer, self._settings)
        assert self._settings.camera is not None
        rays = at_equal_time(family, ours, [self._settings.camera], self._settings.gaze, _RAYS)
        return None if rays is None else family(rays)


def require_moving(scene: Scene) -> MovingScene:
    """What moves in a scene; UserError if nothing does."""
    if scene.moving is None:
        raise UserError(f"{scene.name}: nothing moves in this scene")
    return scene.moving


def _clip(tracer: Tracer, moving: MovingScene, camera: Camera, number: int, spp: int) -> _Clip:
    step = 1 / (moving.motion.seconds * _FRAMES_PER_SECOND)
    last = (number + 1) / (_CLIPS + 0.5)
    times = [max(0.0, last - step * before) for before in range(_FRAMES - 1, -1, -1)]
    earlier = times[-1 - _UNCOVERED : -1]
    hidden = np.any([_moves(tracer, moving, camera, at) for at in earlier], axis=0)
    moving.set_time(earlier[0])
    before = _reference(tracer, camera, spp)
    moves = _moves(tracer, moving, camera, last)
    truth = _reference(tracer, camera, spp)
    changed = np.abs(luminance(truth) - luminance(before)) > _SHADOW * (luminance(truth) + _DARK)
    still = ~moves & ~hidden
    return _Clip(times, _gaze_on(moves), truth, moves, hidden & ~moves, changed & still)


def _moves(tracer: Tracer, moving: MovingScene, camera: Camera, at: float) -> NDArray[np.bool_]:
    """(H, W) where something that moves is seen at a time, which the scene shows from now on."""
    moving.set_time(at)
    tracked = {shape.id() for shape in moving.shapes}
    numbers = [n for n, shape in enumerate(tracer.scene.mitsuba.shapes()) if shape.id() in tracked]
    found = tracer.hits(camera, frame_positions(camera)).shape
    return np.isin(found, numbers).reshape(camera.height, camera.width)


def _reference(tracer: Tracer, camera: Camera, spp: int) -> Image:
    return reference(tracer, camera, spp, REFERENCE_SEED).radiance


def _gaze_on(moves: NDArray[np.bool_]) -> Gaze:
    """The pixel of what moves that is closest to its middle; the centre of the frame if nothing is seen."""
    rows, columns = np.nonzero(moves)
    if not len(rows):
        return Gaze()
    middle = np.median(rows), np.median(columns)
    nearest = int(np.argmin((rows - middle[0]) ** 2 + (columns - middle[1]) ** 2))
    height, width = moves.shape
    return Gaze((columns[nearest] + 0.5) / width, (rows[nearest] + 0.5) / height)


def _squares(image: Image, truth: Image) -> NDArray[np.float32]:
    """(H, W) mean squared errors of sRGB values."""
    errors = (srgb_from_radiance(image) - srgb_from_radiance(truth)) ** 2
    return np.asarray(errors.mean(axis=-1), dtype=np.float32)
