"""Renders what the window shows, request by request on one thread, once scene and forest are prepared."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera
from hybrid.base.compute_device import PassClock, release_memory
from hybrid.base.progress import Progress, bars_of
from hybrid.preparation.preparation import found_forest, with_forest
from hybrid.preparation.scene_plan import scene_as_stored
from hybrid.render.frame import Frame
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.image_files import write_srgb
from hybrid.render.irradiance import cache_for
from hybrid.window.messages import Ready, Request, ShownFrame, ShownView
from hybrid.window.window_views import ConvergingFrame, image_of
from pathtrace.scene.backend import select_backend
from pathtrace.trace.integrator import Integrator

# Samples per pixel added at once when nothing moves: one at a time, fusing would take most of the time.
_PATIENT_SPP = 6
# The same for the path-traced frame, in steps of a sixteenth of a sample.
_PATIENT_STEPS = 8
# Samples per pixel of the disc beyond which nobody sees a difference.
_ENOUGH = 4096
# Seconds between two releases of unused memory, each of which takes three to six milliseconds.
_RELEASE_EVERY = 2.0


class FrameSource:
    """Frames of one scene."""

    def __init__(self, renderer: LiveRenderer):
        self.renderer = renderer
        self._last: ShownFrame | None = None
        self._converging: ConvergingFrame | None = None
        self._seed = 0
        self._released = time.monotonic()

    @property
    def camera(self) -> Camera:
        """The scene's own camera."""
        return self.renderer.scene.camera

    @property
    def layers(self) -> int:
        """Number of layers of the forest."""
        return len(self.renderer.periphery.forest.counts)

    def ready(self) -> Ready:
        """What the window needs to know."""
        scene = self.renderer.scene
        distance = scene.surfaces().median_distance(scene.camera)
        distance = distance if np.isfinite(distance) else 1.0
        seconds = None if scene.moving is None else scene.moving.motion.seconds
        return Ready(scene.name, scene.camera, distance, self.layers, seconds)

    def show(self, request: Request, quick: bool) -> ShownFrame:
        """The requested image, a little better with each call; if `quick`, in no more time."""
        self._seed += 1
        # What frames of another size or kind needed.
        if time.monotonic() - self._released > _RELEASE_EVERY:
            release_memory()
            self._released = time.monotonic()
        last = self._last if request.same_frame(self._last.request if self._last else None) else None
        frame, paths = self._rendered(request, last.frame if last else None, quick)
        # A frame that is only shown again has taken no time.
        fresh = last is None or frame is not last.frame
        passes = dict(frame.milliseconds) if fresh else {}
        before = passes.pop("total", 0.0)
        clock = PassClock()
        path_traced, more_paths = None, 0
        if request.view.needs_path_traced:
            path_traced, more_paths = self._path_traced(frame, quick)
            clock.lap("reference")
        image = image_of(request.view, frame, path_traced)
        clock.lap("picture")
        rest = clock.milliseconds()
        rest["total"] += before
        self._last = ShownFrame(
            image,
            request,
            frame,
            paths + more_paths,
            passes | rest,
            path_traced.samples if path_traced else 0,
            paths == 0 and (path_traced is None or path_traced.complete),
        )
        return self._last

    def forget(self) -> None:
        """Renders the next frame as if it were the first one."""
        self._last = None
        self.renderer.forget()

    def save(self, png: Path) -> None:
        """Writes what was shown last: the image as PNG and, beside it, the AOVs of its frame as EXR."""
        if self._last is not None:
            write_srgb(png, self._last.image)
            self.renderer.with_aovs(self._last.frame).save(png.with_suffix(".exr"))

    def _rendered(self, request: Request, frame: Frame | None, quick: bool) -> tuple[Frame, int]:
        """The hybrid frame of a request, from the frame so far if any, and how many paths it took now."""
        if frame is None:
            frame = self.renderer.frame(request.settings, self._seed)
            return frame, frame.settings.traced_spp * frame.fovea.disc.count
        samples = frame.fovea.samples
        if request.view is ShownView.PATH_TRACED or not samples.size or samples.mean_count() >= _ENOUGH:
            return frame, 0
        spp = request.settings.spp if quick else max(_PATIENT_SPP, request.settings.spp)
        frame = self.renderer.refined(frame, spp, self._seed, quick)
        return frame, replace(frame.settings, spp=spp).traced_spp * frame.fovea.disc.count

    def _path_traced(self, frame: Frame, quick: bool) -> tuple[ConvergingFrame, int]:
        """A frame's view, path-traced with more samples, and how many paths those took."""
        if self._converging is None or self._converging.camera != frame.camera:
            splats = self.renderer.splats(frame.settings)
            self._converging = ConvergingFrame(self.renderer.tracer, frame.camera, splats)
        converging = self._converging
        steps = 0 if converging.complete else 1 if quick else _PATIENT_STEPS
        return converging, sum(converging.refine() for _ in range(steps))


def prepared(
    scene: str,
    forest: Path | None,
    backend: str,
    trains: bool,
    settings: FrameSettings,
    report: Progress,
    thin_glass: bool = False,
    sensor: str | None = None,
) -> FrameSource:
    """The source of a scene's frames, the first of which has these settings; arguments as in `run_window`.

    If there is no forest, one is trained if `trains`. UserError if the scene or the forest is missing, or if
    they do not belong together.
    """
    # Before the scene is loaded, since the backend decides what it is loaded into.
    select_backend(backend)
    loaded, bars = scene_as_stored(scene, thin_glass=thin_glass, sensor=sensor), bars_of(report)
    loaded, file = found_forest(loaded, forest, bars)
    if not trains and file is None:
        raise UserError(f"{scene}: there is no forest yet; run hybrid demo {scene} first, which trains one")
    loaded, found = with_forest(loaded, file, bars)
    if settings.used_integrator is Integrator.CACHED:
        cache_for(loaded, bars)
    return FrameSource(LiveRenderer(loaded, found))
