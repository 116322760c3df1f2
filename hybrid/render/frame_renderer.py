"""Hybrid frames: path-traced disc, splatted periphery, blended; one by one, or in sequence for a window.

In sequence they are rendered quickly at first and then, while nothing changes, improved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError, require_seed
from compose.camera.camera import Camera
from compose.eye.detail import DetailMap
from compose.fovea.cells import CellRegion
from compose.fovea.disc import Disc, blend
from compose.fovea.foveation import FoveaMode, FoveaRegion, Placement
from compose.fovea.samples import Samples
from compose.image.colour import Image
from compose.image.device_image import DeviceImage
from hybrid.base.compute_device import PassClock, device_arrays
from hybrid.base.identity import require_scene
from hybrid.render.disc_images import Underlay
from hybrid.render.expected_errors import ExpectedErrors
from hybrid.render.forest_attachments import scene_as_trained
from hybrid.render.forest_light import ForestLight
from hybrid.render.fovea import Fovea, FoveaImage
from hybrid.render.frame import Frame
from hybrid.render.frame_settings import DEFAULTS, EXTRA_AOVS, INTERACTIVE, FrameSettings
from hybrid.render.hole_filling import MOVING, STILL, Fill, Filler
from hybrid.render.irradiance import CachedTracer, cache_for, filled_cache
from hybrid.render.periphery import Periphery
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from splat.lod.layer_images import SplatImage, black_image
from splat.model.forest import Forest


class Renderer:
    """Renders hybrid frames of one scene with one forest.

    Args:
        scene: what is path-traced; if nothing is planned for it, with the paths planned for the forest.
        forest: its Gaussians.
        history: whether the fovea reuses the samples of earlier frames.
        roulette_depth: path depth from which Russian roulette ends paths; that of the scene by default.

    Raises:
        UserError: the forest belongs to another scene.

    Examples:
        >>> scene = hybrid.load_scene("room")
        >>> renderer = hybrid.Renderer(scene, hybrid.load_forest("room.forest"))
        >>> frame = renderer.frame(hybrid.FrameSettings(gaze=(0.4, 0.6), spp=4, aovs=("depth",)))
        >>> frame.save("frame.exr")
    """

    # Whether samples are distributed evenly and, in a new frame, made an image in less time.
    _is_quick = False
    # How well what the forest does not know is traced, and whether the frame shows what the last one showed.
    _effort, _still = STILL, False

    def __init__(
        self, scene: Scene, forest: Forest, *, history: bool = False, roulette_depth: int | None = None
    ):
        self.scene, self._arrays = scene_as_trained(scene, forest), device_arrays()
        self.tracer = Tracer(self.scene, roulette_depth=roulette_depth)
        self._history, self._roulette_depth = history, roulette_depth
        self._foveas: dict[Integrator, Fovea] = {}
        self._cached: CachedTracer | None = None
        self._as_loaded = True
        # Draws the forest in other light than that before the first change of which anything was known.
        self._light: ForestLight | None = None
        self.show_forest(forest)

    def show_forest(self, forest: Forest) -> None:
        """Draws another forest of the scene from now on; UserError if it belongs to another scene."""
        require_scene(forest, self.scene.name, self.scene.hash, "this forest")
        self.periphery, self._time = Periphery(self._arrays, forest), 0.0
        self._filler, self._errors = Filler(self._arrays, forest), ExpectedErrors(self._arrays, forest)
        self._foveas.clear()
        if self._light is not None:
            self._light = ForestLight(forest, self._light.usual)
            self._light_splats()

    def tracer_of(self, integrator: Integrator) -> Tracer:
        """The scene's tracer with an integrator; `tracer` is the unbiased one."""
        return self.tracer if integrator is Integrator.PATH else self._cached_tracer().tracer

    def fovea_of(self, settings: FrameSettings) -> Fovea:
        """The fovea of frames with these settings; samples of different integrators are never mixed."""
        integrator = settings.used_integrator
        if integrator not in self._foveas:
            self._foveas[integrator] = Fovea(self.tracer_of(integrator), self._history)
        return self._foveas[integrator]

    def lights_changed(self) -> None:
        """Says that lights of `scene.mitsuba` changed: brightness or colour, not shape or number.

        Samples of earlier frames are dropped. With the cached integrator, each of the following frames renews
        a part of the light that is known, until all of it is (`light_renewed`); the first one follows the
        change roughly. So do splats, whose radiance follows the irradiance of surfaces, if a frame with that
        integrator was rendered before the change; else they stay as they were trained.
        """
        self._change()
        if self._cached is not None:
            self._cached.lights_changed()
        self.forget()

    def surfaces_changed(self) -> None:
        """Says that geometry or materials of `scene.mitsuba` changed.

        Samples of earlier frames are dropped, and the next frame of the cached integrator waits until its
        cache is filled anew. Splats stay where they are; their light follows as in `lights_changed`.
        """
        self._change()
        if self.scene.instanced is not None:
            self.scene.instanced.follow()
        self.tracer, self._cached = Tracer(self.scene, roulette_depth=self._roulette_depth), None
        self.forget()
        self._foveas.clear()

    def _change(self) -> None:
        if self._as_loaded and self._cached is not None:
            self._light = ForestLight(self.periphery.forest, self._cached.cache)
        self._as_loaded = False

    @property
    def light_renewed(self) -> float:
        """Share, 0 to 1, of the light in the cache that is known as it is after the last change of lights."""
        return 1.0 if self._cached is None else self._cached.renewed

    def forget(self) -> None:
        """Drops the samples of earlier frames."""
        self._filler.forget()
        for fovea in self._foveas.values():
            fovea.disc.forget()

    def _cached_tracer(self) -> CachedTracer:
        """Ends paths in the scene's cache, which is filled now if there is none."""
        if self._cached is None:
            # The stored cache is that of the scene as it was loaded.
            cache = cache_for(self.scene) if self._as_loaded else filled_cache(self.scene)
            self._cached = CachedTracer(self.scene, cache, self._roulette_depth)
            self._light_splats()
        return self._cached

    def _relight(self, settings: FrameSettings) -> None:
        """Renews a part of the light that is known, if paths end in it and it is old."""
        if settings.used_integrator is Integrator.CACHED and self.light_renewed < 1:
            cached = self._cached_tracer()
            is_first = not cached.renewed
            cached.update()
            if is_first or cached.renewed == 1:
                self._light_splats()

    def _light_splats(self) -> None:
        """Draws the forest in the light that is known, once that is not the usual one any more."""
        if self._light is not None and self._cached is not None:
            self.periphery = Periphery(self._arrays, self._light.under(self._cached.cache))
            self.periphery.set_time(self._time)

    def frame(self, settings: FrameSettings = DEFAULTS, seed: int = 0) -> Frame:
        """Renders one frame.

        Args:
            settings: how to make it.
            seed: same seed, same frame on the same machine; from 0 to compose.base.errors.MOST_SEED.

        Raises:
            UserError: the forest does not have the layers that the settings ask for, or the seed is out of
                range.
        """
        seed = require_seed(seed)
        # First: a cache that is filled for it leaves the scene at another time.
        self.fovea_of(settings)
        clock = PassClock()
        camera, settings = self._begun(settings)
        self._relight(settings)
        region = self._region(camera, settings)
        disc = region.disc(self._arrays)
        clock.lap("region")
        detail, drawn, under = self._drawn(camera, settings, region, clock)
        clock.lap("splat")
        fill = self._fill(camera, settings, seed)
        periphery = drawn if fill is None else fill.over(drawn)
        underlay = self.underlay(camera, settings, region, fill, under)
        clock.lap("fill")
        fovea = self._fovea(settings, camera, disc, seed, periphery, underlay, clock, self._is_quick)
        composite, behind = blend(periphery, fovea.radiance, fovea.disc)
        clock.lap("blend")
        frame = Frame(
            image=composite,
            settings=settings,
            camera=camera,
            behind=behind,
            detail=detail,
            nodes_drawn=drawn.nodes,
            fovea=fovea,
            underlay=underlay,
            region=region,
            milliseconds=clock.milliseconds(),
            fill=fill,
        )
        return self.with_aovs(frame, settings.aovs) if settings.aovs else frame

    def _region(self, camera: Camera, settings: FrameSettings) -> FoveaRegion | CellRegion:
        """Where a frame's paths are traced; scene and forest show its time."""
        if settings.traces_cells:
            return self._errors.region(camera, settings)
        return settings.foveation.region(camera.width, camera.height)

    def _fovea(
        self,
        settings: FrameSettings,
        camera: Camera,
        disc: Disc,
        seed: int,
        periphery: DeviceImage | None,
        underlay: Underlay | None,
        clock: PassClock,
        quick: bool,
    ) -> FoveaImage:
        """Traces a disc and makes the fovea from its samples, in less time if `quick`."""
        maker, mode = self.fovea_of(settings), settings.fovea
        disc, samples = maker.trace(mode, camera, disc, settings.traced_spp, seed, underlay, self._is_quick)
        clock.lap("trace")
        fovea = maker.image(mode, disc, samples, periphery, underlay, quick)
        clock.lap("fovea")
        return fovea

    def _drawn(
        self, camera: Camera, settings: FrameSettings, region: FoveaRegion | CellRegion, clock: PassClock
    ) -> tuple[DetailMap, SplatImage, SplatImage | None]:
        """The detail of a frame, the splats that the fovea leaves visible and, if fused, those under it."""
        detail = self.periphery.detail(camera, settings, self._is_quick)
        clock.lap("detail")
        if settings.fovea is FoveaMode.FUSED:
            return detail, *self.periphery.draw_with_disc(camera, settings, detail, region)
        return detail, self.periphery.draw(camera, detail, region), None

    def _begun(self, settings: FrameSettings) -> tuple[Camera, FrameSettings]:
        """The camera and the settings of a frame; scene and forest show its time from now on."""
        camera, settings = self._resolved(settings)
        moving, time = self.scene.moving, settings.time
        if moving is not None:
            moving.set_time(time)
            if self._time != time:
                self._time = time
                self._filler.forget()
            # What is known from earlier frames follows.
            moment = moving.moment()
            for fovea in self._foveas.values():
                fovea.disc.show(moment)
        elif time:
            raise UserError(f"time {time:g}: nothing moves in {self.scene.name}")
        self.periphery.set_time(time)
        self._errors.set_time(time)
        return camera, settings

    def _resolved(self, settings: FrameSettings) -> tuple[Camera, FrameSettings]:
        """The camera and the settings of a frame, as far as the forest allows them."""
        if settings.traces_cells and not self._errors.are_known:
            settings = replace(settings, paths=Placement.DISC)
        return settings.resolved(self.scene.camera)

    def _fill(self, camera: Camera, settings: FrameSettings, seed: int) -> Fill | None:
        """What is path-traced where the forest does not know the view; None if it knows all of it."""
        if not settings.fill:
            return None
        integrator = settings.used_integrator
        # While lights are being renewed, what was traced before is old.
        key = integrator if self._still and self.light_renewed == 1 else None
        effort = self._effort if key is None else STILL
        return self._filler.fill(camera, self.tracer, lambda: self.tracer_of(integrator), effort, seed, key)

    def underlay(
        self,
        camera: Camera,
        settings: FrameSettings,
        region: FoveaRegion | CellRegion,
        fill: Fill | None = None,
        under: SplatImage | None = None,
    ) -> Underlay | None:
        """The splats under the disc, drawn now unless given, with what is filled; None unless fused."""
        if settings.fovea is not FoveaMode.FUSED:
            return None
        if under is None:
            under = self.periphery.under_disc(camera, settings, region)
        # A copy: what lies under the disc of a still view is drawn once.
        radiance = under if fill is None else fill.over(under.packed())
        return Underlay(camera, radiance, self._errors.typical_in(camera))

    def disc_alone(self, settings: FrameSettings, seed: int) -> FoveaImage:
        """A frame's disc, without rendering a periphery."""
        # As in `frame`, first.
        self.fovea_of(settings)
        camera, settings = self._begun(settings)
        region = self._region(camera, settings)
        self._relight(settings)
        fill = self._fill(camera, settings, seed) if settings.fovea is FoveaMode.FUSED else None
        underlay = self.underlay(camera, settings, region, fill)
        disc, black = region.disc(self._arrays), black_image(self._arrays, camera)
        fovea = self._fovea(settings, camera, disc, seed, black, underlay, PassClock(), self._is_quick)
        dr.eval(fovea.radiance)
        dr.sync_thread()
        return fovea

    def paths(self, settings: FrameSettings) -> float:
        """Expected number of paths traced for a frame."""
        camera, settings = self._begun(settings)
        disc = self._region(camera, settings).disc(self._arrays)
        return self.fovea_of(settings).paths(settings.fovea, disc, settings.traced_spp)

    def splats(self, settings: FrameSettings = DEFAULTS) -> Image:
        """(H, W, 3) the finest allowed layer over the whole frame, including what a fovea would hide."""
        camera, settings = self._begun(settings)
        return self.periphery.whole(camera, settings).numpy()

    def with_aovs(self, frame: Frame, names: Sequence[str] = EXTRA_AOVS) -> Frame:
        """A frame of this renderer with some of EXTRA_AOVS, whatever its settings ask for."""
        of = {"splat": lambda: self.splats(frame.settings), "depth": lambda: self.depth(frame.camera)}
        return replace(frame, more={name: of[name]() for name in names})

    def depth(self, camera: Camera) -> NDArray[np.float32]:
        """(H, W) depth of the first hit along the view axis, in world units; inf where nothing is hit."""
        hits = self.tracer.hits(camera, frame_positions(camera))
        cosine = camera.rays(camera.pixel_centres()) @ camera.camera_to_world[:3, 2]
        depth = hits.distance * cosine * self.scene.place.unit
        return depth.astype(np.float32).reshape(camera.height, camera.width)


# Ending paths early saves more time than it adds noise, and every frame adds samples: on `room` it takes
# 25 ms instead of 53 at 1.5 times the variance; on staircase2 time and variance change by the same factor.
_ROULETTE_DEPTH = 1


class LiveRenderer(Renderer):
    """Renders frames in sequence, with a fovea that reuses the samples of earlier frames.

    While the camera moves, what is filled is traced quickly; when it stands still, once.
    """

    _is_quick, _effort = True, MOVING

    def __init__(self, scene: Scene, forest: Forest):
        super().__init__(scene, forest, history=True, roulette_depth=_ROULETTE_DEPTH)
        # Camera and time.
        self._last_view: tuple[Camera, float] | None = None

    def frame(self, settings: FrameSettings = INTERACTIVE, seed: int = 0) -> Frame:
        """Renders one frame; what depends on the camera alone is kept until it moves."""
        return super().frame(settings, seed)

    def _drawn(
        self, camera: Camera, settings: FrameSettings, region: FoveaRegion | CellRegion, clock: PassClock
    ) -> tuple[DetailMap, SplatImage, SplatImage | None]:
        view = camera, settings.time
        self._still, self._last_view = view == self._last_view, view
        # Continuous levels of detail follow the gaze.
        if not self._still or settings.is_continuous:
            return super()._drawn(camera, settings, region, clock)
        detail = self.periphery.detail(camera, settings)
        clock.lap("detail")
        drawn, whole = self.periphery.draw_still(camera, settings, detail, region)
        return detail, drawn, whole if settings.fovea is FoveaMode.FUSED else None

    def refined(self, frame: Frame, spp: int, seed: int, quick: bool) -> Frame:
        """The last frame with `spp` more samples per pixel in its disc, made in less time if `quick`."""
        clock, settings = PassClock(), replace(frame.settings, spp=spp)
        self._relight(settings)
        disc, periphery = frame.fovea.disc, frame.splats
        fovea = self._fovea(settings, frame.camera, disc, seed, periphery, frame.underlay, clock, quick)
        composite, _ = blend(periphery, fovea.radiance, disc)
        clock.lap("blend")
        return replace(frame, image=composite, fovea=fovea, milliseconds=clock.milliseconds())

    def add_samples(self, frame: Frame, spp: int, seed: int) -> Samples:
        """Traces `spp` more samples per pixel in the last frame's disc, for the next refined one.

        Returns all that are known.
        """
        settings, disc, under = replace(frame.settings, spp=spp), frame.fovea.disc, frame.underlay
        self._relight(settings)
        maker, spp = self.fovea_of(settings), settings.traced_spp
        return maker.trace(settings.fovea, frame.camera, disc, spp, seed, under, self._is_quick)[1]

    def forget(self) -> None:
        """Drops everything that is known from earlier frames."""
        super().forget()
        self._last_view = None
