"""Prepares a scene: frames and forest in turns, from nothing to what was asked for."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from compose.base.errors import UserError
from hybrid.frame.irradiance import cache_for
from hybrid.preparation.judges import Judges
from hybrid.preparation.settings import PreparationSettings
from hybrid.preparation.stages import QUALITIES, Stage, next_stage
from hybrid.preparation.views import breadth_of, stated_error, views_of, wanted_of
from hybrid.runtime.progress import Bars, console, progress_bar
from hybrid.store.cache import scene_folder, store_forest
from hybrid.store.identity import short_hash
from hybrid.store.journal import Journal
from hybrid.training.forest import train
from hybrid.training.fusion import with_fusion
from pathtrace.dataset.capture import capture
from pathtrace.dataset.frames import read_frame_set
from pathtrace.dataset.growing import GrowingFrames
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.region.region import Region, region_of
from pathtrace.scene.difficulties import light_difficulties
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces
from pathtrace.trace.integrator import Integrator
from pathtrace.trace.tracer import Tracer
from splat.io.forest_file import load_forest, save_forest
from splat.model.forest import Forest
from splat.training.trainer import TrainingSettings

# What the fusion is fitted to: views with unbiased frames, and parts of them.
FUSION_CAPTURE = CaptureSettings(views=1, held_out=4, spp=1, held_out_spp=64)
# Seconds that fitting the fusion takes where stages take as long as they say; left out of a shorter job.
_FUSION_SECONDS = 45.0
# Stages after which a target is given up, and the least gain in dB for which another stage is begun.
_MOST_STAGES, _LEAST_GAIN = 8, 0.15
# Before that, more views and pixels may bring more than the last stage did.
_LEAST_STAGES = 3


@dataclass(frozen=True)
class Prepared:
    """A forest, with what its preparation took.

    Attributes:
        forest: the forest.
        facts: what `hybrid prepare --json` writes.
    """

    forest: Forest
    facts: dict[str, Any]


def prepare(
    scene: Scene,
    settings: PreparationSettings | None = None,
    bars: Bars = progress_bar,
    folder: Path | None = None,
    started: float | None = None,
) -> Prepared:
    """Prepares a scene; the forest becomes its newest one after every stage. Resumes if interrupted.

    Args:
        scene: what to prepare.
        settings: how far, and what judges it; the defaults of PreparationSettings if None.
        bars: show the progress of each part.
        folder: for everything that is written; a folder of the scene's in the cache by default.
        started: time.perf_counter() from which the time counts; now if None.

    Raises:
        UserError: the region has no free space, a target cannot be reached, or a file cannot be written.
    """
    settings = settings or PreparationSettings()
    start = time.perf_counter() if started is None else started
    for difficulty in light_difficulties(scene):
        console.print(str(difficulty), soft_wrap=True)
    surfaces = Surfaces(scene)
    region = region_of(scene, surfaces, settings.region)
    identity = {"scene": scene.hash, "region": region.identity(), **asdict(settings)}
    folder = folder or scene_folder(scene.name, scene.hash) / f"prepared-{short_hash(identity)}"
    folder.mkdir(parents=True, exist_ok=True)
    return _Job(scene, region, surfaces, settings, bars, folder, Journal(folder / "job.json", identity)).run(
        start
    )


class _Job:
    """A preparation under way; what is done is in its folder and its journal."""

    def __init__(
        self,
        scene: Scene,
        region: Region,
        surfaces: Surfaces,
        settings: PreparationSettings,
        bars: Bars,
        folder: Path,
        journal: Journal,
    ):
        self._scene, self._region, self._surfaces, self._settings = scene, region, surfaces, settings
        self._bars, self._folder, self._journal = bars, folder, journal
        self._spent: float = journal.once("seconds", lambda: 0.0)
        self._stages: list[Stage] = []
        self._curve: list[dict[str, Any]] = []

    def run(self, start: float) -> Prepared:
        """Does what is left to do; time counts from `start`."""
        self._since = start
        try:
            return self._run()
        finally:
            # An interrupted job continues with the time that it took so far.
            self._journal["seconds"] = self._seconds()

    def _run(self) -> Prepared:
        tracer = Tracer(self._scene, cache=cache_for(self._scene, self._bars))
        frames = GrowingFrames(self._folder / "frames", tracer, Integrator.CACHED.value, self._settings.seed)
        judges, forest = self._judges(tracer), None
        breadth = self._journal.once(
            "breadth", lambda: breadth_of(self._region, self._surfaces, self._settings.seed)
        )
        while (stage := self._next(breadth)) is not None:
            self._stages.append(stage)
            forest = self._staged(frames, stage, forest)
            self._judge(judges, forest)
        assert forest is not None
        self._journal.once("frame_error_db", lambda: stated_error(frames))
        forest = self._with_fusion(forest)
        store_forest(forest, self._folder.name)
        facts = self._facts(forest, frames)
        self._require_target(facts)
        return Prepared(forest, facts)

    def _judges(self, tracer: Tracer) -> Judges:
        """The held-out views; their time does not count."""
        wanted = self._settings
        with self._not_counted():
            cameras = (
                self._region.unseen_views(wanted.held_out, *wanted.size, wanted.seed)
                if wanted.held_out
                else []
            )
            with self._bars("held-out views") as bar:
                return Judges(self._folder / "held-out", tracer, cameras, bar)

    def _next(self, breadth: float) -> Stage | None:
        """The next stage as the journal has it, else as it is planned now; None at the end."""
        number = len(self._stages)
        planned = self._journal.once(f"stage {number}", lambda: self._planned(number, breadth))
        return Stage(**planned) if planned else None

    def _planned(self, number: int, breadth: float) -> dict[str, Any] | None:
        if self._is_enough(number):
            return None
        left = None
        if self._settings.minutes is not None:
            left = 60 * self._settings.minutes - self._seconds()
            left -= _FUSION_SECONDS * self._pace() if self._fits_fusion else 0
        stage = next_stage(number, breadth, self._pace(), left)
        return asdict(stage) if stage else None

    def _is_enough(self, number: int) -> bool:
        """Whether what was asked for is reached, or no more is to be had."""
        if not number:
            return False
        found = [row["psnr"] for row in self._curve if "psnr" in row]
        gained = len(found) < _LEAST_STAGES or found[-1] - found[-2] >= _LEAST_GAIN
        if self._settings.psnr is not None:
            return found[-1] >= self._settings.psnr or not gained or number >= _MOST_STAGES
        if self._settings.minutes is not None:
            return number >= _MOST_STAGES
        return number >= QUALITIES[self._settings.quality] or not gained

    @property
    def _fits_fusion(self) -> bool:
        minutes = self._settings.minutes
        return minutes is None or 60 * minutes > 2 * _FUSION_SECONDS

    def _pace(self) -> float:
        """Seconds that stages took, over those that they take by their description; 1 before the first."""
        described = sum(stage.seconds for stage in self._stages)
        taken = sum(self._journal[f"seconds {number}"] for number in range(len(self._stages)))
        return taken / described if described else 1.0

    def _staged(self, frames: GrowingFrames, stage: Stage, before: Forest | None) -> Forest:
        """The forest after the last of the stages; trained now, unless it is in the folder."""
        number = len(self._stages) - 1
        path = self._folder / f"stage-{number}.safetensors"
        if f"seconds {number}" in self._journal and path.is_file():
            return load_forest(path)
        start = self._seconds()
        views = views_of(self._region, self._stages, self._settings.seed)
        with self._bars(f"stage {number + 1}: frames (samples)") as bar:
            wanted = wanted_of(frames, views, stage, before)
            frames.grow(wanted, bar)
        settings = TrainingSettings(
            stage.steps, stage.gaussians, stage.layers if number else 1, seed=self._settings.seed + number
        )
        with self._bars(f"stage {number + 1}: forest (steps)") as bar:
            forest = train(read_frame_set(frames.folder), path, settings, bar, start=before)
        if number:
            store_forest(forest, self._folder.name)
        self._journal[f"seconds {number}"] = self._seconds() - start
        return forest

    def _judge(self, judges: Judges, forest: Forest) -> None:
        """Adds a row to the curve."""
        number = len(self._stages) - 1

        def row() -> dict[str, Any]:
            seconds = self._seconds()
            with self._not_counted():
                found = judges.quality(forest)
            return {"seconds": seconds, **found, "gaussians": len(forest.finest)}

        self._curve.append(self._journal.once(f"quality {number}", row))
        shown = self._curve[-1]
        quality = (
            f", held-out views {shown['psnr']:.2f} dB, SSIM {shown['ssim']:.4f}" if "psnr" in shown else ""
        )
        console.print(
            f"{shown['seconds']:.0f} s: {sum(stage.views for stage in self._stages)} views, "
            f"{shown['gaussians']:,} Gaussians{quality}",
            soft_wrap=True,
        )

    def _with_fusion(self, forest: Forest) -> Forest:
        """The forest with a fusion fitted to it, of which single frames make use."""
        path = self._folder / "forest.safetensors"
        if path.is_file():
            return load_forest(path)
        if self._fits_fusion:
            cache = cache_for(self._scene)
            with self._bars("fusion: frames (samples)") as bar:
                examples = capture(self._scene, self._folder / "fusion", FUSION_CAPTURE, bar, cache)
            with self._bars("fusion (steps)") as bar:
                forest = with_fusion(examples, forest, self._settings.seed, bar)
        save_forest(path, forest)
        return forest

    def _facts(self, forest: Forest, frames: GrowingFrames) -> dict[str, Any]:
        samples, last = frames.samples, self._curve[-1]
        return {
            "scene": self._scene.name,
            "region": self._region.name,
            "seconds": self._journal.once("total", self._seconds),
            "gaussians": len(forest.finest),
            "views": len(samples),
            "spp": {"mean": sum(samples) / len(samples), "least": min(samples), "most": max(samples)},
            "frame_error_db": self._journal["frame_error_db"],
            "splat": {name: last[name] for name in ("psnr", "ssim") if name in last},
            "curve": self._curve,
            "forest": str(self._folder / "forest.safetensors"),
        }

    def _require_target(self, facts: dict[str, Any]) -> None:
        """UserError if a target was not reached; the forest is kept."""
        wanted, found = self._settings.psnr, facts["splat"].get("psnr")
        if wanted is not None and found < wanted:
            raise UserError(
                f"{self._scene.name}: {wanted:g} dB cannot be reached; {found:.2f} dB are, in "
                f"{facts['seconds']:.0f} s, from frames of {facts['frame_error_db']:.1f} dB; it is kept"
            )

    def _seconds(self) -> float:
        """Seconds that count, over all runs of the job."""
        return float(self._spent + time.perf_counter() - self._since)

    @contextmanager
    def _not_counted(self) -> Iterator[None]:
        """Stops the clock."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._since += time.perf_counter() - start
