"""How well and how fast methods show a scene that plays, as in the window, region by region."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from compose.base.errors import UserError
from compose.base.traced_samples import SPECULAR
from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from compose.image.colour import Image, luminance, srgb_from_radiance
from hybrid.base.identity import require_scene
from hybrid.base.progress import Steps, no_progress
from hybrid.evaluation.baselines_traced import enlarged
from hybrid.evaluation.equal_cost import rays_at_equal_time
from hybrid.evaluation.last_frame import LastFrameRenderer
from hybrid.evaluation.methods import HybridMethod
from hybrid.measure.frame_times import percentiles, ratio_of_medians
from hybrid.measure.image_metrics import ImageRegion, psnr_of_error, regions, registration_px
from hybrid.measure.perceptual_metrics import jod_of_video
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.splat_renderer import SplatRenderer
from pathtrace.scene.moving_scene import MovingScene
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest

MOVING = "moving"
# Regions that are judged as videos, too.
_AS_VIDEO = "whole", "foveal"
HYBRID, ALONE, SPLATS, TRACED = "hybrid", "hybrid, no history", "splats alone", "path-traced, denoised"
TWO_EYES = "splats alone, two eyes"
# By what layers are chosen in Fov-GS's ablation (Table 3): acuity, and contrast sensitivity.
_MODELS = "fov-gs", "stelacsf"
# By what its first two rows select nodes: where they were in the frame before, by acuity.
_LAST_FRAME = "last frame"
# Between the eyes, as a share of the median distance of what is seen: 6.4 cm in a room of four metres.
BETWEEN_EYES = 1 / 64
# Clips, spread over the time of the scene; frames of each, of which the last is judged; and of a second.
_CLIPS, _FRAMES, _FRAMES_PER_SECOND = 6, 8, 13.0
# Frames before the last one in which something else was at the place of what has just been uncovered.
_UNCOVERED = 4
# Relative change of luminance over these frames from which on a still surface counts as in a moving shadow.
_SHADOW = 0.05
_DARK = 1e-3
# Pixels up to which a still surface is beside a moving shadow.
_BESIDE = 8
# Frames of a clip that are not timed: the first ones wait for kernels.
_WARM_UP = 2
# Paths per pixel of the path-traced frames, from which their number at equal time is sought.
_RAYS = 0.25


def bench_moving(
    scene: Scene,
    forest: Forest,
    settings: FrameSettings,
    reference_spp: int,
    progress: Steps,
    against: Mapping[str, Forest] | None = None,
) -> list[dict[str, Any]]:
    """One row per method and region of a scene that plays, with the gaze on what moves most visibly.

    The settings are those of the frames, with their camera, apart from gaze and time. References have
    `reference_spp` samples per pixel. The forests in `against`, by their names, are drawn as splats alone.
    UserError if nothing moves in the scene, or if a forest belongs to another one.

    Rows have `method`, `region`, `psnr` of the pixels of all clips together, `pixels`, `ms` per frame (`p50`,
    `p95`) and `ratio`, the hybrid's median over the method's; those of the whole frame and the fovea `jod`,
    the mean of the clips as videos; those of what moves `registration_px`, the median shift of textured
    windows at least a quarter of which moves. Both are None if unknown. Times include the scene's step of
    time, or the forest's. Path-traced frames are denoised, and of so many pixels that they take as long as
    the hybrid's; they are left out if the smallest takes longer.
    """
    moving = require_moving(scene)
    camera, _ = settings.resolved(scene.camera)
    for name, other in (against or {}).items():
        require_scene(other, scene.name, scene.hash, name)
    renderer = LiveRenderer(scene, forest)
    methods = _Methods(renderer, {SPLATS: forest, **(against or {})}, replace(settings, camera=camera))
    found: dict[str, _Found] = {}
    for number in range(_CLIPS):
        clip = _clip(renderer.tracer, moving, camera, number, reference_spp)
        for method, shown in methods.played(clip).items():
            found.setdefault(method, _Found()).add(clip, shown, settings)
        progress(number + 1, _CLIPS)
    return [
        {"method": method, **row, "ratio": ratio_of_medians(found[HYBRID].milliseconds, of.milliseconds)}
        for method, of in found.items()
        for row in of.rows()
    ]


# From settings with their time, and a seed, to a frame.
_Frame = Callable[[FrameSettings, int], Image]


@dataclass(frozen=True)
class _Clip:
    """A few frames of a scene that plays, and the truth of the last one.

    Attributes:
        times: (T,) of the frames, from 0 to 1.
        gaze: on what moves.
        truths: T of (H, W, 3) reference radiance.
        masks: (H, W) by the names of regions: what moves (MOVING); what stands still and was hidden by what
            moves (uncovered); what stands still, was not hidden, and has another luminance than a few frames
            before (shadow); what is close to that, stands still and has not changed (beside); and what has
            changed in mirrors, which belongs to neither (reflected).
    """

    times: Sequence[float]
    gaze: Gaze
    truths: Sequence[Image]
    masks: dict[str, NDArray[np.bool_]]

    def regions(self, settings: FrameSettings) -> dict[str, ImageRegion]:
        """Of the last frame, by name; those without a pixel are left out."""
        found = regions(replace(settings, gaze=self.gaze).foveation, self.truths[-1])
        return {name: found[name] for name in (*_AS_VIDEO, "salient")} | {
            name: ImageRegion.of(name, mask) for name, mask in self.masks.items() if mask.any()
        }


# The frames of a clip, (H, W, 3) each, and milliseconds of those that are timed.
_Shown = tuple[Sequence[Image], list[float]]


class _Found:
    """What is found of one method, clip by clip, and `milliseconds` of all its timed frames."""

    def __init__(self) -> None:
        self.milliseconds: list[float] = []
        self._errors: dict[str, list[NDArray[np.float32]]] = {}
        self._jods: dict[str, list[float | None]] = {}
        self._shifts: list[float] = []

    def add(self, clip: _Clip, shown: _Shown, settings: FrameSettings) -> None:
        """Judges the last frame of a clip region by region, and all of them as a video."""
        images, milliseconds = shown
        self.milliseconds += milliseconds
        errors = (srgb_from_radiance(images[-1]) - srgb_from_radiance(clip.truths[-1])) ** 2
        squares = np.asarray(errors.mean(axis=-1), dtype=np.float32)
        found = clip.regions(settings)
        for name, region in found.items():
            self._errors.setdefault(name, []).append(squares[region.mask])
        for name in _AS_VIDEO:
            region = found[name]
            pairs = zip(images, clip.truths, strict=True)
            seen = [region.alone(image, truth)[region.box] for image, truth in pairs]
            truths, gaze = [truth[region.box] for truth in clip.truths], region.gaze_within(clip.gaze)
            score = jod_of_video(seen, truths, _FRAMES_PER_SECOND, settings.display, gaze)
            self._jods.setdefault(name, []).append(score)
        shift = registration_px(images[-1], clip.truths[-1], clip.masks[MOVING])
        self._shifts += [] if shift is None else [shift]

    def rows(self) -> Iterator[dict[str, Any]]:
        """One per region."""
        for name, errors in self._errors.items():
            row = {
                "region": name,
                "psnr": psnr_of_error(float(np.mean(np.concatenate(errors), dtype=np.float64))),
                "pixels": int(sum(map(len, errors))),
                "ms": percentiles(self.milliseconds, (50, 95)),
            }
            if name in self._jods:
                scores = [score for score in self._jods[name] if score is not None]
                row["jod"] = float(np.mean(scores)) if scores else None
            if name == MOVING:
                row["registration_px"] = float(np.median(self._shifts)) if self._shifts else None
            yield row


class _Methods:
    """Methods that show a clip; the forests are drawn as splats alone, the scene's own one as SPLATS."""

    def __init__(self, renderer: LiveRenderer, forests: Mapping[str, Forest], settings: FrameSettings):
        self._renderer, self._settings = renderer, settings
        self._splats: dict[str, _Frame] = {}
        self._selecting: dict[str, LastFrameRenderer] = {}
        for name, forest in forests.items():
            self._splats |= _splats(name, forest)
            if forest.motion is not None and len(forest.counts) > 1:
                self._selecting[f"{name}, {_LAST_FRAME}"] = LastFrameRenderer(forest)
        camera, _ = settings.resolved(renderer.scene.camera)
        depth = renderer.depth(camera)
        seen = float(np.median(depth[np.isfinite(depth)])) / renderer.scene.place.unit
        self._right_eye = camera.moved_right(BETWEEN_EYES * seen)
        self._methods: dict[str, _Frame] = {HYBRID: self._frame, ALONE: self._fresh_frame}
        self._methods |= {**self._splats, TWO_EYES: self._both_eyes}
        # Path-traced frames that take as long as the hybrid's, if any do.
        family = partial(enlarged, renderer.tracer_of(Integrator.CACHED), 1, denoised=True)
        ours = HybridMethod(renderer, settings)
        found = rays_at_equal_time(
            {TRACED: family}, ours, View(camera), settings.gaze, {TRACED: _RAYS}, no_progress
        )
        rays = found[TRACED]
        if rays is not None:
            render = family(rays).render
            self._methods[TRACED] = lambda shown, seed: (
                render(View(camera, shown.time), shown.gaze, seed).image
            )

    def played(self, clip: _Clip) -> dict[str, _Shown]:
        """The clip by each method in turn."""
        self._renderer.forget()
        found = {name: self._timed(clip, method) for name, method in self._methods.items()}
        return found | {name: self._selected(clip, method) for name, method in self._selecting.items()}

    def _timed(
        self, clip: _Clip, method: _Frame, before: Callable[[FrameSettings], None] = lambda settings: None
    ) -> _Shown:
        """The clip by a method; what is done `before` each frame is not timed."""
        milliseconds, images = [], []
        for number, at in enumerate(clip.times):
            settings = replace(self._settings, time=at, gaze=clip.gaze)
            before(settings)
            start = time.perf_counter()
            images.append(method(settings, number))
            milliseconds.append((time.perf_counter() - start) * 1000)
        return images, milliseconds[_WARM_UP:]

    def _selected(self, clip: _Clip, renderer: LastFrameRenderer) -> _Shown:
        """The clip with what each frame before has selected."""
        renderer.forget()
        by_acuity = partial(replace, acuity_model=_MODELS[0])
        return self._timed(
            clip,
            lambda settings, seed: renderer.frame(by_acuity(settings)),
            lambda settings: renderer.select(by_acuity(settings)),
        )

    def _frame(self, settings: FrameSettings, seed: int) -> Image:
        return self._renderer.frame(settings, seed).composite

    def _fresh_frame(self, settings: FrameSettings, seed: int) -> Image:
        self._renderer.forget()
        return self._frame(settings, seed)

    def _both_eyes(self, settings: FrameSettings, seed: int) -> Image:
        """What the left eye sees; the right one has its image from the same step of time."""
        left = self._splats[SPLATS](settings, seed)
        self._splats[SPLATS](replace(settings, camera=self._right_eye), seed)
        return left


def _splats(name: str, forest: Forest) -> dict[str, _Frame]:
    """The finest layer of a forest over the whole frame; of one with layers, those by acuity as well."""
    renderer = SplatRenderer(forest)

    def foveated(model: str, settings: FrameSettings, seed: int) -> Image:
        return renderer.frame(replace(settings, acuity_model=model)).composite

    models = _MODELS if len(forest.counts) > 1 else ()
    found: dict[str, _Frame] = {name: lambda settings, seed: renderer.splats(settings)}
    return found | {f"{name}, {model}": partial(foveated, model) for model in models}


def require_moving(scene: Scene) -> MovingScene:
    """What moves in a scene; UserError if nothing does."""
    if scene.moving is None:
        raise UserError(f"{scene.name}: nothing moves in this scene")
    return scene.moving


def _clip(tracer: Tracer, moving: MovingScene, camera: Camera, number: int, spp: int) -> _Clip:
    step = 1 / (moving.motion.seconds * _FRAMES_PER_SECOND)
    last = (number + 1) / (_CLIPS + 0.5)
    times = [max(0.0, last - step * before) for before in range(_FRAMES - 1, -1, -1)]
    moving_pixels, truths = [], []
    for at in times:
        moving.set_time(at)
        tracked = {shape.id() for shape in moving.shapes}
        numbers = [n for n, shape in enumerate(tracer.scene.mitsuba.shapes()) if shape.id() in tracked]
        shapes = tracer.hits(camera, frame_positions(camera)).shape
        moving_pixels.append(np.isin(shapes, numbers).reshape(camera.height, camera.width))
        truths.append(reference(tracer, camera, spp, REFERENCE_SEED).radiance)
    moves, hidden = moving_pixels[-1], np.any(moving_pixels[-1 - _UNCOVERED : -1], axis=0)
    before, now = luminance(truths[-1 - _UNCOVERED]), luminance(truths[-1])
    changed = np.abs(now - before) > _SHADOW * (now + _DARK)
    # Where something specular is seen, what changes is no shadow.
    positions = frame_positions(camera)
    gloss = tracer.auxiliary(camera, positions, 1, REFERENCE_SEED).gloss.numpy()
    mirrors = tracer.hits(camera, positions).reflected | (gloss == SPECULAR)
    still, mirrors = ~moves & ~hidden, mirrors.reshape(camera.height, camera.width)
    shadow = changed & still & ~mirrors
    beside = binary_dilation(shadow, iterations=_BESIDE) & still & ~mirrors & ~shadow
    masks = {
        MOVING: moves,
        "uncovered": hidden & ~moves,
        "shadow": shadow,
        "beside": beside,
        "reflected": changed & still & mirrors,
    }
    return _Clip(times, _gaze_on(moves), truths, masks)


def _gaze_on(moves: NDArray[np.bool_]) -> Gaze:
    """The pixel of what moves that is closest to its middle; the centre of the frame if nothing is seen."""
    rows, columns = np.nonzero(moves)
    if not len(rows):
        return Gaze()
    middle = np.median(rows), np.median(columns)
    nearest = int(np.argmin((rows - middle[0]) ** 2 + (columns - middle[1]) ** 2))
    height, width = moves.shape
    return Gaze((columns[nearest] + 0.5) / width, (rows[nearest] + 0.5) / height)
