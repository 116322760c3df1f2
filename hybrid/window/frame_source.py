"""Renders what the window shows, request by request on one thread, once scene and forest are prepared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from compose.camera.camera import Camera
from hybrid.base.cache_folder import scene_folder
from hybrid.base.compute_device import PassClock, SpareMemory
from hybrid.base.progress import Progress, bars_of
from hybrid.preparation.preparation import prepare, with_forest
from hybrid.preparation.scene_plan import as_stored, with_plan_of
from hybrid.preparation.stages import GLIMPSE, PreparationSettings
from hybrid.render.forest_attachments import scene_as_trained, views_of
from hybrid.render.forest_light import ForestLight
from hybrid.render.frame import Frame
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.image_files import write_srgb
from hybrid.render.irradiance import cache_for
from hybrid.window.learning import ShownScene, Task, Viewer, Watched, forest_to_show
from hybrid.window.messages import Ready, Request, ShownFrame, ShownView
from hybrid.window.window_views import ConvergingFrame, image_of, late_warped, nearness
from pathtrace.scene.backend import select_backend
from pathtrace.scene.scene import load_scene
from pathtrace.trace import Integrator
from splat.io.forest_file import save_forest

# Samples per pixel added at once when nothing moves: one at a time, fusing would take most of the time.
_PATIENT_SPP = 6
# The same for the path-traced frame, in steps of a sixteenth of a sample.
_PATIENT_STEPS = 8
# Samples per pixel of the disc beyond which nobody sees a difference.
_ENOUGH = 4096
# In the folder of a scene that has changed: the forest of before, in the light of now.
_AS_CHANGED = "as-changed.safetensors"


class FrameSource(Protocol):
    """Renders what the window asks for, on one thread."""

    @property
    def camera(self) -> Camera:
        """The scene's own camera."""

    @property
    def layers(self) -> int:
        """Number of layers of the forest."""

    def ready(self) -> Ready:
        """What the window needs to know."""

    def show(self, request: Request, quick: bool) -> ShownFrame:
        """The requested image, a little better with each call; if `quick`, in no more time."""

    def warped(self, shown: ShownFrame, newest: Camera) -> ShownFrame:
        """The last frame as another camera sees it, if that can be told; see `late_warped`."""

    def renew(self, report: Progress) -> bool:
        """Takes what has changed or been learnt since the last time; whether frames look different now.

        UserError if the cache folder cannot be written.
        """

    def save(self, png: Path) -> None:
        """Writes what was shown last: the image as PNG and, beside it, its frame as EXR."""

    def close(self) -> None:
        """Ends what runs beside."""


class SceneSource:
    """Frames of a scene that is here, which may change and be learnt meanwhile if it is watched."""

    def __init__(self, renderer: LiveRenderer, watched: Watched | None = None, forest: Path | None = None):
        """Also takes the file of the renderer's forest, from which a changed scene is learnt."""
        self.renderer, self._watched, self._forest = renderer, watched, forest
        self._viewer = Viewer()
        self._last: ShownFrame | None = None
        self._converging: ConvergingFrame | None = None
        self._seed = 0
        self._memory = SpareMemory()

    @property
    def camera(self) -> Camera:
        return self.renderer.scene.camera

    @property
    def layers(self) -> int:
        return len(self.renderer.periphery.forest.counts)

    def ready(self) -> Ready:
        scene = self.renderer.scene
        distance = scene.surfaces().median_distance(scene.camera)
        distance = distance if np.isfinite(distance) else 1.0
        seconds = None if scene.moving is None else scene.moving.motion.seconds
        return Ready(scene.name, scene.camera, distance, self.layers, seconds)

    def show(self, request: Request, quick: bool) -> ShownFrame:
        self._seed += 1
        if self._watched is not None:
            self._watched.share_threads(rests=not quick)
        layers = request.settings.layers
        if layers is not None and layers[1] > self.layers:
            # The forest may just have replaced another one.
            layers = min(layers[0], self.layers), self.layers
            request = replace(request, settings=replace(request.settings, layers=layers))
        self._memory.release()
        last = self._last if self._last and request.same_frame(self._last.request) else None
        frame, paths = self._rendered(request, last.frame if last else None, quick)
        # A frame that is only shown again has taken no time.
        before = {} if last and frame is last.frame else frame.milliseconds
        clock = PassClock()
        path_traced, more_paths = None, 0
        if request.view.needs_path_traced:
            path_traced, more_paths = self._path_traced(frame, quick)
            clock.lap("reference")
        image = image_of(request.view, frame, path_traced)
        clock.lap("picture")
        self._last = ShownFrame(
            image,
            request,
            frame,
            paths + more_paths,
            clock.milliseconds(before),
            path_traced.samples if path_traced else 0,
            paths == 0 and (path_traced is None or path_traced.complete),
        )
        return self._last

    def warped(self, shown: ShownFrame, newest: Camera) -> ShownFrame:
        return late_warped(shown, newest, partial(nearness, tracer=self.renderer.tracer))

    def renew(self, report: Progress) -> bool:
        if self._watched is None:
            return False
        scene, before = self._watched.changed(), self.renderer.scene
        if scene is not None:
            # Shown with the splats of before, in the light of now, until it is learnt.
            scene, forest = with_plan_of(scene, before), self.renderer.periphery.forest
            if self._last is not None and self._last.request.settings.used_integrator is Integrator.CACHED:
                forest = ForestLight(forest, cache_for(before)).under(cache_for(scene, bars_of(report)))
            forest = replace(forest, scene_name=scene.name, scene_hash=scene.hash)
            self._forest = scene_folder(scene.name, scene.hash) / _AS_CHANGED
            save_forest(self._forest, forest)
            self.renderer = LiveRenderer(scene, forest)
            self._last = self._converging = None
            self._watched.learn(Task.after(before, self._forest, self._viewer.place))
            return True
        learnt = self._watched.learnt()
        if learnt is not None:
            self._forest, forest = learnt
            if forest.scene_hash == before.hash:
                self.renderer.show_forest(forest)
            else:
                # The scene had no plan before.
                self.renderer = LiveRenderer(before, forest)
            self._last = self._converging = None
        self._follow()
        return learnt is not None

    def _follow(self) -> None:
        """Learns what is around a viewer who stays where no training view is near."""
        assert self._watched is not None
        if self._last is None or self._forest is None or not self._watched.learns:
            return
        if not self._viewer.stays(self._last.frame.camera):
            return
        scene = self.renderer.scene
        if self._viewer.is_away(scene, views_of(self.renderer.periphery.forest)):
            self._watched.learn(Task.after(scene, self._forest, self._viewer.settle()))

    def close(self) -> None:
        if self._watched is not None:
            self._watched.stop()

    def forget(self) -> None:
        """Renders the next frame as if it were the first one."""
        self._last = None
        self.renderer.forget()

    def save(self, png: Path) -> None:
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
    scene: ShownScene,
    forest: Path | None,
    learns: bool,
    settings: FrameSettings,
    report: Progress,
    say: Callable[[str], object],
) -> SceneSource:
    """The source of a scene's frames, the first of which has these settings.

    Unless a forest file is given, the best one at hand is shown, or one that takes seconds; if `learns`,
    better ones follow, and `say` gets lines about them. UserError if the scene or the forest is missing, or
    if they do not belong together.
    """
    # Before the scene is loaded, since the backend decides what it is loaded into.
    select_backend(scene.backend)
    bars = bars_of(report)
    loaded = as_stored(load_scene(scene.source, thin_glass=scene.thin_glass, sensor=scene.sensor))
    path, is_unfinished = (forest, False) if forest else forest_to_show(loaded)
    if path is None:
        glimpse = prepare(loaded, PreparationSettings(quality=GLIMPSE, held_out=0), bars)
        found, path = glimpse.forest, Path(glimpse.facts["forest"])
        loaded = scene_as_trained(loaded, found)
    else:
        loaded, found = with_forest(loaded, path, bars)
    if settings.used_integrator is Integrator.CACHED:
        cache_for(loaded, bars)
    watched = Watched(scene, learns and forest is None, say)
    if is_unfinished:
        watched.learn(Task(str(path)))
    return SceneSource(LiveRenderer(loaded, found), watched, path)
