"""The interactive loop: what is rendered next, when, and with which of the settings measured on this machine.

A controller keeps frames at a target rate by choosing among measured settings; it adapts to the machine's
load. Settings are measured once, from coarse to fine: times on the scene's own view, quality on views that
training has not seen.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from PIL import Image as Pillow

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.base.progress import Progress
from hybrid.evaluation.measured_settings import MeasuredSettings, MeasuredStore, front_of
from hybrid.measure.frame_times import gaze_path
from hybrid.measure.image_metrics import ssim
from hybrid.measure.perceptual_metrics import jod
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.frame_source import FrameSource, SceneSource
from hybrid.window.messages import Request, ShownFrame
from pathtrace.region.neighbourhood import unseen_views

# Share of the target time that frames are planned to take, because times vary.
_PLANNED = 0.85
# How quickly the controller accepts that the machine has become slower, and that it is faster again.
_SLOWER, _FASTER = 0.5, 0.08
# Largest climb per frame, in steps of the ladder; it descends at once.
_CLIMB = 0.12
# A frame counts as at most this many times the expected time, because one outlier is not a load.
_MOST = 3.0
# No machine becomes a thousand times as fast as it was when it was measured. Frames of 0 ms, which a coarse
# clock yields, would otherwise lead to a load of 0, at which any settings are affordable for ever.
_LEAST_LOAD = 1e-3


class FrameTimeController:
    """Chooses settings from a ladder so that frames take the target time, in milliseconds.

    The load is the time of a frame over the time measured for its settings, averaged over recent frames.
    ValueError if the ladder is empty, its times do not increase, or the target is not positive.
    """

    def __init__(self, ladder: Sequence[MeasuredSettings], target: float):
        self._ladder, self._times = list(ladder), [one.milliseconds for one in ladder]
        if not ladder or np.any(np.diff(self._times) <= 0):
            raise ValueError("a ladder requires settings, each slower than the one before it")
        if not target > 0:
            raise ValueError(f"target of {target} ms: must be positive")
        self.target, self.load = target, 1.0
        # On the ladder, with fractions between two settings.
        self._position = self._affordable()

    def choice(self) -> MeasuredSettings:
        """The settings of the next frame; between two on the ladder, radius and time are interpolated."""
        below = int(self._position)
        lower = self._ladder[below]
        if below + 1 == len(self._ladder):
            return lower
        upper, share = self._ladder[below + 1], self._position - below
        growth = max(0.0, upper.settings.fov_a - lower.settings.fov_a)
        return replace(
            lower,
            settings=lower.settings.with_radius(lower.settings.fov_a + share * growth),
            milliseconds=lower.milliseconds + share * (upper.milliseconds - lower.milliseconds),
        )

    @property
    def expected(self) -> float:
        """Milliseconds that the next frame is expected to take, at most the target."""
        return min(self.choice().milliseconds * self.load, self.target)

    def took(self, milliseconds: float) -> None:
        """Adapts the load and the choice to the time that the frame of the last choice took.

        A time that is negative or not finite, such as that of a frame that never ended, tells nothing about
        the load and changes nothing.
        """
        if not 0 <= milliseconds < math.inf:
            return
        relative = min(milliseconds / self.choice().milliseconds, _MOST * self.load)
        load = self.load + (_SLOWER if relative > self.load else _FASTER) * (relative - self.load)
        self.load = max(load, _LEAST_LOAD)
        self._position = min(self._affordable(), self._position + _CLIMB)

    def _affordable(self) -> float:
        """The highest position at which frames are expected to meet the target."""
        return float(np.interp(_PLANNED * self.target / self.load, self._times, np.arange(len(self._times))))


def applied(choice: MeasuredSettings, requested: FrameSettings) -> FrameSettings:
    """The requested settings with the chosen radius (the band keeps its share), samples and so on."""
    settings = choice.settings
    return replace(
        requested.with_radius(settings.fov_a),
        spp=settings.spp,
        layers=settings.layers,
        rate=settings.rate,
        scale=settings.scale,
    )


# Seconds without a change after which frames may take longer, for more samples each.
_QUICK_FOR = 1.0


class FrameLoop:
    """Renders frame after frame; `ladder` measures the settings to choose from for frames like a request.

    The next frame should not begin before `due`, a time.perf_counter. While `idle`, there is nothing to do
    until another frame is requested.
    """

    def __init__(self, source: FrameSource, ladder: Callable[[Request], Sequence[MeasuredSettings]]):
        self._source, self._ladder = source, ladder
        self._request: Request | None = None
        self._settings: FrameSettings | None = None
        self._changed = 0.0
        self._controller: FrameTimeController | None = None
        self._measured_for: tuple[object, ...] = ()
        self._returned = 0.0
        self.due, self.idle = 0.0, True

    def make(self, request: Request) -> ShownFrame:
        """The requested frame; a better one if the last request was the same."""
        again = request.same_frame(self._request)
        if not again or self._settings is None:
            self._request, self._settings = request, self._chosen(request)
            self._changed = time.perf_counter()
        start = time.perf_counter()
        quick = start - self._changed <= _QUICK_FOR
        shown = self._source.show(replace(request, settings=self._settings), quick)
        end, self.due = time.perf_counter(), 0.0
        if request.target_fps is not None and self._controller is not None:
            if not again:
                self._controller.took((end - start) * 1000)
            if quick:
                # An early frame is held back, since a steady rate is wanted.
                time.sleep(max(0.0, self._returned + 1 / request.target_fps - end))
                # As late as the next frame can begin and still be ready one period after this one: its gaze
                # is newest then.
                spare = 1000 / request.target_fps - self._controller.expected
                self.due = time.perf_counter() + spare / 1000
        self._returned = time.perf_counter()
        self.idle = shown.finished
        return shown

    def _chosen(self, request: Request) -> FrameSettings:
        settings, target_fps = request.settings, request.target_fps
        if target_fps is None:
            return settings
        camera = settings.camera or self._source.camera
        # Of the user's choices, those that the measured times depend on.
        measured_for = camera.width, camera.height, settings.acuity_model
        if self._controller is None or measured_for != self._measured_for:
            self._controller = FrameTimeController(self._ladder(request), 1000 / target_fps)
            self._measured_for = measured_for
        self._controller.target = 1000 / target_fps
        return applied(self._controller.choice(), settings)


# Held-out views on which quality is measured, and samples per pixel of their references.
_VIEWS, _REFERENCE_SPP = 3, 16
# Timed frames, and frames before them that are not timed.
_TIMED, _WARM_UP = 5, 2
_RADII = (5.0, 8.0, 11.0, 15.0, 20.0, 25.0, 30.0)
_ACTIVITY = "measuring settings"


def ladder_for(source: FrameSource, like: Request, report: Progress) -> list[MeasuredSettings]:
    """The Pareto-optimal settings of the window, each slower and better than the one before it.

    The request has the window's size, acuity model and display. UserError if the cache folder cannot be
    written, or if a file in it is damaged.
    """
    if not isinstance(source, SceneSource):
        return [MeasuredSettings(like.settings, 1.0, 0.0)]
    window = like.settings.camera or source.camera
    camera = source.camera.resized(window.width, window.height)
    settings = replace(like.settings, camera=camera, gaze=Gaze(), scale=1.0)
    renderer, size = source.renderer, (camera.width, camera.height)
    store = MeasuredStore("window", renderer.scene, renderer.periphery.forest, size, settings)
    found = store.load()
    if found is None:
        found = "quality", _measured(source, camera, settings, report)
        store.save(*found)
    return front_of(found[1])


def candidates(base: FrameSettings, layers: int) -> list[FrameSettings]:
    """Settings from very coarse to very fine, with the base's acuity model, display and share of the band."""
    plain = replace(base, spp=1, layers=None, rate=0, scale=1.0)
    of = {radius: plain.with_radius(radius) for radius in _RADII}
    found = [replace(of[radius], scale=scale) for scale in (0.5, 0.75) for radius in (8.0, 15.0)]
    found += [replace(of[radius], rate=1) for radius in (8.0, 15.0)]
    found += [replace(of[8.0], layers=(1, layers - 1))] if layers > 1 else []
    found += of.values()
    found += [replace(of[radius], spp=spp) for spp in (2, 4) for radius in (15.0, 20.0, 30.0)]
    return list(dict.fromkeys(found))


def _measured(
    source: SceneSource, camera: Camera, base: FrameSettings, report: Progress
) -> list[MeasuredSettings]:
    wanted = candidates(base, source.layers)
    report(0, len(wanted) + 1, _ACTIVITY)
    # Views that training has not seen, at the window's resolution, with their radiance (H, W, 3).
    views, renderer = [], source.renderer
    for number, view in enumerate(unseen_views(renderer.scene, _VIEWS, camera.width, camera.height)):
        renderer.scene.show(view.time)
        truth = reference(renderer.tracer, view.camera, _REFERENCE_SPP, REFERENCE_SEED + number)
        views.append((view, truth.radiance))
    measured = []
    for number, settings in enumerate(wanted):
        report(number + 1, len(wanted) + 1, _ACTIVITY)
        # Of frames while the gaze moves.
        times = []
        for gaze in gaze_path(_WARM_UP + _TIMED):
            start = time.perf_counter()
            source.show(Request(replace(settings, gaze=gaze)), quick=True)
            times.append((time.perf_counter() - start) * 1000)
        quality = float(np.mean([_quality(source, settings, *judged) for judged in views]))
        measured.append(MeasuredSettings(settings, float(np.median(times[_WARM_UP:])), quality))
    report(len(wanted) + 1, len(wanted) + 1, _ACTIVITY)
    source.forget()
    return measured


def _quality(source: SceneSource, settings: FrameSettings, view: View, truth: Image) -> float:
    """JOD, or SSIM without FovVideoVDP, of a view's first frame for a viewer with the settings' gaze."""
    source.forget()
    own = replace(settings, camera=view.camera, time=view.time)
    composite = source.show(Request(own), quick=True).frame.composite
    size = view.camera.width, view.camera.height
    if composite.shape[1::-1] != size:
        # At the window's resolution, as the window shows it.
        channels = (Pillow.fromarray(channel) for channel in np.moveaxis(composite, 2, 0))
        enlarged = [np.asarray(channel.resize(size, Pillow.Resampling.BILINEAR)) for channel in channels]
        composite = np.stack(enlarged, axis=2)
    found = jod(composite, truth, settings.display, settings.gaze)
    return ssim(composite, truth) if found is None else found
