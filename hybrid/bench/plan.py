"""What each decision of a plan gains and loses, alone and together, at equal training time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.arrays import BackendName
from compose.camera.view import View
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.bench.choices import FIXED, PLANNED, Choices
from hybrid.bench.measured_training import measured_training
from hybrid.frame.irradiance import cache_for
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from hybrid.measure.quality import plain_metrics
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.measure.regions import regions
from hybrid.measure.timing import interleaved, percentiles
from hybrid.plan.paths import DEPTH
from hybrid.plan.plan import ScenePlan
from hybrid.runtime.progress import Bars
from hybrid.store.journal import Journal
from pathtrace.dataset.capture import capture
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.dataset.views import unseen_views
from pathtrace.scene.scene import Scene
from pathtrace.trace.depths import UNBOUNDED
from pathtrace.trace.tracer import Tracer
from splat.io.compact import compact
from splat.io.forest_file import load_forest, save_forest
from splat.io.precision import Precision

# Steps of a pilot training, from which those at equal time follow.
_PILOT = 0.25
_WARM_UP = 4
# Frames that fusions are fitted to and prove themselves on, and their samples per pixel: with half of either,
# whether a fusion shows its network is a matter of luck, and worth 3 dB in `staircase2`.
_HELD_OUT, _HELD_OUT_SPP = 6, 128
_REGIONS = ("whole", "foveal")


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        iterations: training steps with the fixed settings; others have as many as take as long.
        views: training views.
        side: of their frames, in pixels.
        judged: views that judge, which no training sees.
        reference_spp: samples per pixel of their references.
        repeats: timed frames of each row.
        seed: of everything.
    """

    iterations: int = 300
    views: int = 40
    side: int = 192
    judged: int = 3
    reference_spp: int = 128
    repeats: int = 20
    seed: int = 0


def bench_plan(
    scene: Scene,
    plan: ScenePlan,
    settings: FrameSettings,
    effort: Effort,
    folder: Path,
    backend: BackendName,
    bars: Bars,
) -> list[dict[str, Any]]:
    """One row per decision: all as if nobody had looked at the scene, each as planned alone, and all planned.

    Args:
        scene: the scene.
        plan: for it.
        settings: of the frames, with the size that the plan is for.
        effort: how much is measured.
        folder: for frames and forests; what is there already is used, so that a bench resumes.
        backend: that trains.
        bars: show the progress.

    Returns:
        Rows of `decision`, `value`, `fixed`; `psnr`, `ssim`, `foveal_psnr`, `foveal_ssim` of hybrid frames,
        against references of paths of any length; `frame_ms` (`p50`, `p95`), frames of all rows in turns;
        `training_mib`, peak of the training process; `file_bytes`; `steps` and `seconds` of the training; and
        `bias`, the share of the mean radiance that is lost to the bound of the path depth.
    """
    identity = {"scene": scene.own_hash, "effort": asdict(effort), "settings": settings.as_json()}
    job = _Job(scene, settings, effort, folder, Journal(folder / "bench.json", identity), backend, bars)
    choices = Choices.planned(plan).rows()
    trained = {name: job.trained(name, row) for name, row in choices.items()}
    renderers = {name: job.renderer(row) for name, row in choices.items()}
    times = job.times(renderers)
    qualities = job.qualities(renderers)
    beyond = plan.decision(DEPTH).evidence["beyond"]
    return [
        {
            "decision": name,
            **_values(name, row),
            **qualities[name],
            "frame_ms": percentiles(times[name]),
            **trained[name],
            "file_bytes": job.file(row).stat().st_size,
            "bias": 0.0 if row.path_depth == UNBOUNDED else beyond,
        }
        for name, row in choices.items()
    ]


def _values(name: str, row: Choices) -> dict[str, Any]:
    if name in (FIXED, PLANNED):
        return {"value": None, "fixed": None}
    return {"value": row.value(name), "fixed": Choices().value(name)}


class _Job:
    """A bench under way."""

    def __init__(
        self,
        scene: Scene,
        settings: FrameSettings,
        effort: Effort,
        folder: Path,
        journal: Journal,
        backend: BackendName,
        bars: Bars,
    ):
        self._scene, self._settings, self._effort, self._folder = scene, settings, effort, folder
        self._journal, self._backend, self._bars = journal, backend, bars

    def file(self, row: Choices) -> Path:
        """Forest file of a row."""
        return self._folder / f"{row.forest}-{row.precision.value}.safetensors"

    def trained(self, name: str, row: Choices) -> dict[str, Any]:
        """Trains the forest of a row, in as much time as with the fixed settings; what that took."""
        pilot, fixed = self._pilot(row), self._pilot(Choices())
        steps = max(1, round(self._effort.iterations * fixed / pilot))
        exact = self.file(replace(row, precision=Precision.FLOAT32))

        def train() -> dict[str, Any]:
            with self._bars(f"{name} ({steps} steps)"):
                settings = row.training(steps, self._effort.seed)
                taken = measured_training(self._captured(row), exact, settings, self._backend)
            return {"steps": steps, "seconds": taken.seconds, "training_mib": taken.peak_bytes / 2**20}

        found: dict[str, Any] = self._journal.once(row.forest, train)
        if row.precision is Precision.COMPACT:
            save_forest(self.file(row), compact(load_forest(exact)))
        return found

    def _pilot(self, row: Choices) -> float:
        """Seconds of a short training."""
        steps = max(1, round(self._effort.iterations * _PILOT))

        def train() -> float:
            settings = row.training(steps, self._effort.seed)
            return measured_training(self._captured(row), None, settings, self._backend).seconds

        seconds: float = self._journal.once(f"pilot {row.forest}", train)
        return seconds

    def _captured(self, row: Choices) -> Path:
        """Folder of the frames of a row."""
        folder, effort = self._folder / row.frames, self._effort
        size = effort.side, effort.side
        settings = CaptureSettings(
            effort.views, _HELD_OUT, *size, row.samples, _HELD_OUT_SPP, seed=effort.seed
        )
        scene = replace(row.of(self._scene), roulette_depth=Choices().roulette_depth)
        cache = cache_for(scene, self._bars)
        with self._bars(f"{row.frames} (samples)") as bar:
            return capture(scene, folder, settings, bar, cache).folder

    def renderer(self, row: Choices) -> Renderer:
        """Renders hybrid frames of a row."""
        scene = row.of(self._scene)
        cache_for(scene, self._bars)
        return Renderer(scene, load_forest(self.file(row)))

    def times(self, renderers: dict[str, Renderer]) -> dict[str, list[float]]:
        """Milliseconds of frames of all rows, in turns."""

        def framed(renderer: Renderer) -> Callable[[Gaze, int], Any]:
            return lambda gaze, seed: renderer.frame(replace(self._settings, gaze=gaze), seed)

        methods = {name: framed(renderer) for name, renderer in renderers.items()}
        with self._bars("frames (rounds)") as bar:
            return interleaved(methods, self._effort.repeats, _WARM_UP, bar)

    def qualities(self, renderers: dict[str, Renderer]) -> dict[str, dict[str, float]]:
        """PSNR and SSIM of frames of unseen views, means over these."""
        camera, _ = self._settings.resolved(self._scene.camera)
        views = unseen_views(self._scene, self._effort.judged, camera.width, camera.height)
        unbounded = Tracer(Choices().of(self._scene))
        found: dict[str, list[dict[str, float]]] = {name: [] for name in renderers}
        with self._bars("judged views") as bar:
            for number, view in enumerate(views):
                self._scene.show(view.time)
                seed = REFERENCE_SEED + number
                truth = reference(unbounded, view.camera, self._effort.reference_spp, seed).radiance
                for name, renderer in renderers.items():
                    found[name].append(self._quality(renderer, view, truth))
                bar(number + 1, len(views))
        return {
            name: {metric: float(np.mean([row[metric] for row in rows])) for metric in rows[0]}
            for name, rows in found.items()
        }

    def _quality(self, renderer: Renderer, view: View, truth: Image) -> dict[str, float]:
        settings = replace(self._settings, camera=view.camera, time=view.time)
        image = renderer.frame(settings, self._effort.seed).composite
        parts = regions(settings.foveation, truth)
        prefixes = {"whole": "", "foveal": "foveal_"}
        return {
            prefixes[name] + metric: value
            for name in _REGIONS
            for metric, value in plain_metrics(image, truth, parts[name]).items()
        }
