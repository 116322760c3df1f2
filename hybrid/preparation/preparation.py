"""Prepares a scene: frames and forest in turns, from nothing to what was asked for."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera
from hybrid.base.cache_folder import newest_forest, scene_folder, store_forest
from hybrid.base.identity import Journal, require_scene, short_hash
from hybrid.base.progress import Bars, no_bars
from hybrid.preparation.decisions import CONVERGED_DB, LAYERS, SAMPLES, breadth_of, planned_needs
from hybrid.preparation.earlier_jobs import FRAMES, JOURNAL, TAKEN_OVER, earlier_job
from hybrid.preparation.forest_errors import Judges, with_errors
from hybrid.preparation.forest_training import planned_settings, train
from hybrid.preparation.lighting import light_over_time
from hybrid.preparation.scene_plan import as_planned, require_plan
from hybrid.preparation.stage_frames import (
    Pass,
    clamping_bias,
    converging_seconds,
    limit_of,
    stage_views,
    stated_error,
    trained_psnr,
    wanted_of,
)
from hybrid.preparation.stage_planner import PROBED, JobClock, Planner
from hybrid.preparation.stages import GLIMPSE, LIVE, PreparationSettings, Stage
from hybrid.render.forest_attachments import attach_seconds, plan_of_forest, scene_as_trained
from hybrid.render.irradiance import cache_for
from pathtrace.dataset.capture import capture
from pathtrace.dataset.frame_set import CaptureSettings, FrameSet, read_frame_set
from pathtrace.dataset.growing import GrowingFrames, StoredFrames
from pathtrace.region import ViewingRegion, region_of
from pathtrace.region.neighbourhood import NearRegion, view_time
from pathtrace.scene.optics import light_difficulties
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator
from pathtrace.trace.tracer import Tracer
from splat.io.forest_file import load_forest, save_forest
from splat.model.dynamic_light import SurfaceLight
from splat.model.forest import Forest

_LOG = logging.getLogger("hybrid")
# Views in which the bias of bounded light is measured.
_JUDGED_BIAS = 6


@dataclass(frozen=True)
class Prepared:
    """A forest, with what its preparation took."""

    forest: Forest
    facts: dict[str, Any]  # what `hybrid prepare --json` writes


@dataclass(frozen=True)
class Beginning:
    """What a preparation goes on from.

    Attributes:
        forest: whose finest layer to go on from.
        jobs: folders of other preparations of the scene, or of the scene before it was changed. Frames are
            taken over from the first one that has any, unless too much has changed in them: what has is
            traced anew.
        place: near which further views are, in place of the region.
    """

    forest: Forest | None = None
    jobs: tuple[Path, ...] = ()
    place: Camera | None = None


# In the folder of a job: the forest that it goes on from, if any, and one of each stage.
_START, _STAGE = "start.safetensors", "stage-{}.safetensors"


@dataclass(frozen=True)
class Staged:
    """What a preparation has come to after a stage."""

    forest: Path
    number: int  # of the stage, from 1
    stages: int  # that are planned; more may follow if a PSNR is to be reached
    seconds: float
    psnr: float  # dB in frames that it was trained on


# Number of the stage, from 0, whose forest is the first to become the newest one of its scene: by quality,
# and by default. A first look never does.
_FIRST_STORED, _SECOND = {GLIMPSE: math.inf, LIVE: 2}, 1


def prepare(
    scene: Scene,
    settings: PreparationSettings | None = None,
    bars: Bars = no_bars,
    folder: Path | None = None,
    started: float | None = None,
    beginning: Beginning = Beginning(),
    told: Callable[[Staged], object] | None = None,
) -> Prepared:
    """Prepares a scene; the forest becomes its newest one after every stage. Resumes if interrupted.

    Args:
        settings: how far to go, and which views validate it; the defaults of PreparationSettings if None.
        folder: for everything that is written; a folder of the scene's in the cache by default.
        started: time.perf_counter() from which the time counts; now if None.
        beginning: what to go on from; if this run resumes another one, that one's.
        told: called after every stage of this run.

    Raises:
        UserError: the region has no free space, a target cannot be reached, or a file cannot be written.
    """
    settings = settings or PreparationSettings()
    started = time.perf_counter() if started is None else started
    for difficulty in light_difficulties(scene):
        _LOG.warning("%s", difficulty)
    # As many samples as there is time for, where they help.
    scene = replace(scene, plan={name: value for name, value in scene.plan.items() if name != SAMPLES})
    surfaces = scene.surfaces()
    place = beginning.place
    region = (
        region_of(scene, surfaces, settings.region) if place is None else NearRegion(scene, surfaces, place)
    )
    planned = {"plan": dict(scene.plan)} if scene.plan else {}
    identity = {**asdict(settings), "scene": scene.hash, "region": region.identity(), **planned}
    kind = settings.quality if settings.quality in _FIRST_STORED else "prepared"
    folder = folder or scene_folder(scene.name, scene.hash) / f"{kind}-{short_hash(identity)}"
    folder.mkdir(parents=True, exist_ok=True)
    if beginning.forest is not None and not (folder / JOURNAL).exists():
        save_forest(folder / _START, beginning.forest)
    journal = Journal(folder / JOURNAL, identity)
    clock = JobClock(journal, started)
    with bars("region") as bar:
        bar(0, 1, "choosing views")
        breadth = journal.once("breadth", lambda: breadth_of(region, surfaces, settings.seed))
    planner = Planner(settings, journal, clock, planned_needs(scene.plan, settings.region, breadth))
    try:
        return _Job(scene, region, settings, bars, folder, planner, beginning, told).run()
    finally:
        # An interrupted job continues with the time that it took so far.
        clock.keep()


@dataclass
class _Job:
    """A preparation under way; what is done is in its folder and its journal."""

    scene: Scene
    region: ViewingRegion
    settings: PreparationSettings
    bars: Bars
    folder: Path
    planner: Planner
    beginning: Beginning
    told: Callable[[Staged], object] | None
    passes: list[Pass] = field(default_factory=list)
    curve: list[dict[str, Any]] = field(default_factory=list)

    def run(self) -> Prepared:
        """Does what is left to do."""
        cache, most = cache_for(self.scene, self.bars), self.settings.most_indirect
        tracer = Tracer(self.scene, cache=cache)
        # Of the training frames.
        bounded = tracer if most is None else Tracer(self.scene, cache=cache, most_indirect=most)
        frames = GrowingFrames(self.folder / FRAMES, bounded, Integrator.CACHED.value, self.settings.seed)
        self._go_on(frames)
        judges, start = self._judges(tracer), self.folder / _START
        forest = load_forest(start) if start.is_file() else None
        while self.planner.begin(self.curve):
            forest = self._staged(frames, forest)
            self._judge(judges, forest)
        # Stages of another preparation that this one goes on from have no rows.
        best = self.planner.number + 1 - len(self.curve) + self._best
        forest = self._finished(frames, load_forest(self.folder / _STAGE.format(best)))
        if self.settings.quality != GLIMPSE:
            store_forest(forest, self.folder.name)
        facts = self._facts(forest, frames)
        facts["clamping_bias"] = self._clamping_bias(bounded, tracer)
        self._conclude(facts)
        return Prepared(forest, facts)

    @property
    def _best(self) -> int:
        """Row of the stage whose forest is kept: the last, or where a PSNR is asked for, the best one."""
        if self.settings.psnr is None:
            return len(self.curve) - 1
        return max(range(len(self.curve)), key=lambda number: self.curve[number].get("psnr", 0.0))

    def _go_on(self, frames: GrowingFrames) -> None:
        """Takes over what another preparation has, if this one goes on from it."""

        def taken() -> dict[str, Any] | None:
            found = (self._taken_over(frames, folder) for folder in self.beginning.jobs)
            return next((one for one in found if one is not None), None)

        found = self.planner.journal.once(TAKEN_OVER, taken)
        if found is not None:
            stages = [Stage(**stage) for stage in found["stages"]]
            self.planner.go_on(stages, found["is_elsewhere"], found["is_changed"])

    def _taken_over(self, frames: GrowingFrames, folder: Path) -> dict[str, Any] | None:
        """What is taken over from a preparation, its stages and what is new; None if nothing is."""
        before = earlier_job(folder)
        if before is None or not before.stages:
            return None
        is_elsewhere = before.region != self.region.identity()
        is_changed = before.scene_hash != self.scene.hash
        if not is_elsewhere and not is_changed and len(before.stages) >= len(self.settings.stages):
            # There would be nothing left to do.
            return None
        try:
            views = sum(stage["views"] for stage in before.stages)
            with self.bars("frames of before (views)") as bar:
                if not frames.take_over(StoredFrames(folder / FRAMES), views, bar):
                    return None
        except UserError as error:
            _LOG.warning("%s; not gone on from", error)
            return None
        return {"stages": before.stages, "is_elsewhere": is_elsewhere, "is_changed": is_changed}

    def _clamping_bias(self, bounded: Tracer, tracer: Tracer) -> float | None:
        """Share of the radiance that training frames lack because indirect light was bounded; None if not."""
        if bounded is tracer:
            return None
        with self.planner.clock.stopped():
            cameras = self.region.views(_JUDGED_BIAS, *self.settings.size, self.settings.seed)
            share = clamping_bias(bounded, tracer, cameras, self.settings.seed)
        _LOG.info("bounding indirect light removed %.2g %% of the radiance", 100 * share)
        return share

    def _judges(self, tracer: Tracer) -> Judges:
        """The held-out views; their time does not count."""
        count, size, seed = self.settings.held_out, self.settings.size, self.settings.seed
        with self.planner.clock.stopped(), self.bars("held-out views") as bar:
            cameras = self.region.unseen_views(count, *size, seed) if count else []
            times = [view_time(self.scene, number + 0.5) for number in range(count)]
            return Judges(self.folder / "held-out", tracer, cameras, times, bar)

    def _staged(self, frames: GrowingFrames, before: Forest | None) -> Forest:
        """The forest after a stage; trained now, unless it is in the folder."""
        number = self.planner.number
        path = self.folder / _STAGE.format(number)
        if self.planner.is_finished and path.is_file():
            self.passes.append(Pass(**self.planner.journal[f"pass {number}"]))
            return load_forest(path)
        self._trace(frames, before)
        stages = self.planner.stages
        seconds = self.planner.lap("frame") + (self.passes[-1].seconds if self.passes else 0.0)
        found = read_frame_set(frames.folder)
        light = None
        if self.scene.moving is not None:
            cache, seed = cache_for(self.scene), self.settings.seed
            light = light_over_time(self.scene, cache, found, stages[-1].gaussians, seed, self.bars)
        self.planner.lap("light")
        brought = lambda: asdict(Pass(float(np.mean(frames.samples)), stated_error(frames), seconds))  # noqa: E731
        self.passes.append(Pass(**self.planner.journal.once(f"pass {number}", brought)))
        forest = self._trained(found, light, path, before)
        if number >= _FIRST_STORED.get(self.settings.quality, _SECOND):
            store_forest(forest, self.folder.name)
        if self.told is not None:
            spent = self.planner.clock.seconds()
            with self.planner.clock.stopped():
                psnr = trained_psnr(frames, forest)
            self.told(Staged(path, number + 1, self.planner.planned, spent, psnr))
        return forest

    def _trace(self, frames: GrowingFrames, before: Forest | None) -> None:
        """Traces the frames of a stage; the first of them tell how many there can be."""
        stages, number = self.planner.stages, self.planner.number
        if stages[-1].extra and not stages[-1].views:
            # What has changed in the frames that there are was traced when they were taken over.
            return
        views = self._views(stages, frames)
        if self.planner.is_to_fit:
            with self.bars("first frames (samples)") as bar:
                wanted = wanted_of(frames, views, stages[0], None)
                # Kernels are compiled for the first one.
                frames.grow(wanted[:1], bar)
                start = time.perf_counter()
                frames.grow(wanted[: 1 + PROBED], bar)
            share = self.planner.fit_first(time.perf_counter() - start)
            if share < 1:
                _LOG.info(
                    f"{share:.0%} of the planned Gaussians leave time for frames of twice the resolution"
                )
            views = self._views(stages, frames)
        with self.bars(f"stage {number + 1}: frames (samples)") as bar:
            frames.grow(wanted_of(frames, views, stages[-1], before), bar)

    def _views(self, stages: Sequence[Stage], frames: GrowingFrames) -> list[tuple[Camera, float]]:
        with self.bars(f"stage {len(stages)}: choosing views") as bar:
            bar(0, sum(stage.views for stage in stages))
            had = [frames.camera(number) for number in range(len(frames.samples))]
            elsewhere = 0 if self.beginning.place is None else self.planner.taken_over
            return stage_views(self.region, stages, self.settings.seed, had, elsewhere)

    def _trained(
        self, frames: FrameSet, light: SurfaceLight | None, path: Path, before: Forest | None
    ) -> Forest:
        """The forest of a stage, in as many steps as there is time for."""
        stage, number = self.planner.stages[-1], self.planner.number
        # More layers than the display tells apart are none that a frame draws; the first frames show one.
        layers = min(stage.layers, frames.plan.get(LAYERS, stage.layers)) if number else 1
        seed = self.settings.seed + number
        if number and stage.views > sum(one.views for one in self.planner.stages[:-1]):
            # Most of what the frames show is new: it is learnt sooner from them alone.
            before = None
        settings = planned_settings(
            frames, iterations=self.planner.steps(), gaussians=stage.gaussians, layers=layers, seed=seed
        )
        # That takes a second, for which nobody waits who waits for a first look, or has so many minutes.
        learns_errors = self.settings.quality != GLIMPSE and self.planner.paced is None
        with self.bars(f"stage {number + 1}: forest (steps)") as bar:
            forest = train(
                frames,
                path,
                settings,
                bar,
                start=before,
                light=light,
                paced=self.planner.paced,
                learns_errors=learns_errors,
            )
        self.planner.lap("training")
        return forest

    def _judge(self, judges: Judges, forest: Forest) -> None:
        number = self.planner.number

        def row() -> dict[str, Any]:
            seconds = self.planner.clock.seconds()
            with self.planner.clock.stopped():
                found = judges.quality(forest)
            return {"seconds": seconds, **found, "gaussians": len(forest.finest)}

        self.curve.append(self.planner.journal.once(f"quality {number}", row))
        shown = self.curve[-1]
        text = ", held-out views {psnr:.2f} dB, least {least_psnr:.2f} dB, SSIM {ssim:.4f}"
        quality = text.format_map(shown) if "psnr" in shown else ""
        views = sum(stage.views for stage in self.planner.stages)
        _LOG.info(f"{shown['seconds']:.0f} s: {views} views, {shown['gaussians']:,} Gaussians{quality}")

    def _finished(self, frames: GrowingFrames, forest: Forest) -> Forest:
        """The forest with what it learns of its errors."""
        path = self.folder / "forest.safetensors"
        if path.is_file():
            return load_forest(path)
        if self.settings.quality != GLIMPSE:
            forest = with_errors(read_frame_set(frames.folder), forest)
        forest = attach_seconds(forest, self.planner.clock.seconds())
        save_forest(path, forest)
        return forest

    def _facts(self, forest: Forest, frames: GrowingFrames) -> dict[str, Any]:
        """What was reached, and what limits it; the latter is None without held-out views."""
        samples, found = frames.samples, self.curve[self._best]
        seconds = self.planner.journal.once("total", self.planner.clock.seconds)
        with self.planner.clock.stopped():
            trained = trained_psnr(frames, forest)
        limit = limit_of(self.passes[-1].error_db, trained, found["psnr"]) if "psnr" in found else None
        return {
            "scene": self.scene.name,
            "region": self.region.name,
            "seconds": seconds,
            "gaussians": len(forest.finest),
            "views": len(samples),
            "spp": {"mean": sum(samples) / len(samples), "least": min(samples), "most": max(samples)},
            "frame_error_db": self.passes[-1].error_db,
            "converging_seconds": converging_seconds(self.passes),
            "splat": {name: found[name] for name in ("psnr", "ssim", "least_psnr") if name in found},
            "curve": self.curve,
            "forest": str(self.folder / "forest.safetensors"),
            "trained_psnr": trained,
            "limit": limit,
        }

    def _conclude(self, facts: dict[str, Any]) -> None:
        """Names frames that converge slowly; UserError if a target was not reached."""
        if facts["converging_seconds"] is not None:
            last = self.passes[-1]
            _LOG.warning(
                f"{self.scene.name}: light converges slowly; frames have {last.error_db:.1f} dB after "
                f"{last.seconds:.0f} s of tracing, {CONVERGED_DB:g} dB would take about "
                f"{facts['converging_seconds']:.0f} s"
            )
        wanted, found = self.settings.psnr, facts["splat"].get("psnr")
        if wanted is not None and found < wanted:
            raise UserError(
                f"{self.scene.name}: {wanted:g} dB cannot be reached; {found:.2f} dB are, in "
                f"{facts['seconds']:.0f} s, from frames of {facts['frame_error_db']:.1f} dB; it is kept"
            )


# Good enough to look at, in a minute and a half.
_QUALITY = "draft"
# The frames that judge its layers: no capture is without a training view.
JUDGED = CaptureSettings(views=1, held_out=4, spp=1, held_out_spp=64)


def found_forest(scene: Scene, given: Path | None, bars: Bars = no_bars) -> tuple[Scene, Path | None]:
    """A scene and its forest file: the given one, else the newest one in the cache; None if there is none.

    A scene that has none is planned: there may be a forest of it as planned.
    """
    path = given or newest_forest(scene)
    if path is None:
        scene = as_planned(scene, bars)
        path = newest_forest(scene)
    return scene, path


def with_forest(scene: Scene, given: Path | None, bars: Bars = no_bars) -> tuple[Scene, Forest]:
    """As `found_forest`, but a forest is prepared now if there is none.

    With a forest at hand, nothing is planned: a scene without a plan has the paths of the forest's plan.
    UserError if the file is missing, damaged or belongs to another scene, or no forest can be trained.
    """
    scene, path = found_forest(scene, given, bars)
    if path is None:
        _LOG.info("No forest for scene %s yet: preparing one first.", scene.name)
        return scene, prepare(scene, PreparationSettings(quality=_QUALITY, held_out=0), bars).forest
    forest = load_forest(path)
    scene = scene_as_trained(scene, forest)
    require_scene(forest, scene.name, scene.hash, path)
    require_plan(plan_of_forest(forest), scene, path)
    return scene, forest


def make_quick_forest(scene: Scene, folder: Path, seed: int, bars: Bars = no_bars) -> tuple[Forest, FrameSet]:
    """Prepares a forest in a folder, with the quick settings; resumes if interrupted.

    Also returns frames with held-out views that judge its layers.
    """
    settings = PreparationSettings(quality=_QUALITY, held_out=0, seed=seed)
    folder = folder / f"prepared-{seed}"
    forest = prepare(scene, settings, bars, folder).forest
    with bars("held-out views (samples)") as bar:
        return forest, capture(scene, folder / "judged", replace(JUDGED, seed=seed), bar)
