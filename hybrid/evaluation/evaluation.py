"""The evaluation of a scene: all ways to make its frames, at equal cost, judged and timed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from hybrid.evaluation.budgets import Tuning
from hybrid.evaluation.entries import OURS, Entry, baseline_entries, hybrid_entries, splat_entries
from hybrid.evaluation.judged import judged
from hybrid.evaluation.settings import FOVEAL_REFERENCE, EvaluationSettings
from hybrid.evaluation.timed import timed
from hybrid.evaluation.tuning import tuned
from hybrid.frame.periphery import Periphery
from hybrid.frame.renderer import Renderer
from hybrid.measure.reference import REFERENCE_SEED, Reference, reference
from hybrid.measure.regions import regions
from hybrid.methods.splats import SplatsAlone
from hybrid.output.images import read_exr, write_exr
from hybrid.runtime.device import device_arrays
from hybrid.runtime.machine import machine
from hybrid.store.cache import scene_folder
from hybrid.store.identity import measured_identity, short_hash
from hybrid.store.journal import Journal
from pathtrace.dataset.views import unseen_views
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Views to tune peers on, beside those that are measured, and how much smaller their sides are.
_TUNING_VIEWS, _TUNING_REDUCTION = 2, 2
# About how many milliseconds each kind of work takes, for the time that is left: for a sample of a reference,
# in all, in all, for a view, for a round of frames.
_COSTS = {"references": 4e-3, "tuning": 44e3, "costs": 72e3, "quality": 63e3, "times": 2.5e3}


class Evaluation:
    """Evaluates one scene with one forest, step by step.

    Args:
        scene, forest: what is rendered.
        settings: what to measure.
        folder: of the report, for images and the journal.
        flat: Gaussians without trees, a baseline; None leaves it out.

    Raises:
        UserError: a forest is one of another scene, or the folder holds another evaluation.
    """

    def __init__(
        self,
        scene: Scene,
        forest: Forest,
        settings: EvaluationSettings,
        folder: Path,
        flat: Forest | None = None,
    ):
        self.scene, self.settings, self.folder = scene, settings, folder
        self.renderer = Renderer(scene, forest)
        self.tracer = self.renderer.tracer
        splats = [SplatsAlone(Periphery(device_arrays(), f)) for f in (forest, flat) if f is not None]
        self.splats, self.flat = splats[0], splats[1] if flat is not None else None
        identity = measured_identity(
            scene,
            forest,
            display=asdict(settings.frame.display),
            settings=settings.as_json(),
            **{"baseline forest": None if flat is None else flat.digest()},
        )
        self.journal = Journal(folder / "work" / "journal.json", identity)
        # What is equal in time is found once on a machine: the same frames are compared ever after.
        file = scene_folder(scene.name, scene.hash) / f"costs-{short_hash(identity)}.json"
        self.costs = Journal(file, identity)

    def run(self, progress: Callable[[str, float, float], None]) -> dict[str, Any]:
        """Does what is not done yet, and returns the content of the JSON file.

        Args:
            progress: called with what is being done, work done and work in all.
        """
        settings = self.settings
        # Before anything else lies in the folder that would belong to nobody.
        self.journal.write()
        views = self._views()
        measured_views = views[: settings.views]
        work = _Work(settings, progress)
        references = [self._reference(number, camera, work) for number, camera in enumerate(measured_views)]
        entries = self._entries(views, work)
        parts = settings, self.folder, self.journal
        quality = judged(entries, measured_views, references, *parts, work.of("quality"))
        time = timed(entries, views[0], settings.frame.gaze, settings.repeats, self.journal, work.of("times"))
        return {
            "scene": self.scene.name,
            "settings": settings.as_json(),
            "display": asdict(settings.frame.display),
            "references": [row for numbered in enumerate(references) for row in self._errors(*numbered)],
            "methods": [
                {
                    "method": entry.name,
                    "budget": entry.budget,
                    "rays": entry.method.rays(views[0], settings.frame.gaze),
                    **entry.method.settings,
                }
                for entry in entries
            ],
            "quality": quality,
            "time": time,
            "machine": machine(),
        }

    def _views(self) -> list[Camera]:
        """Views around the scene's own, which training has seen; those to tune on at the end."""
        settings = self.settings
        count = settings.views + _TUNING_VIEWS
        size = settings.width, settings.height
        return unseen_views(self.scene, count, *size)

    def _reference(self, number: int, camera: Camera, work: _Work) -> Reference:
        """A reference, from its file if there is one."""
        file = self.folder / "work" / f"reference-{number}.exr"
        if not file.exists():
            found = reference(self.tracer, camera, self._samples(), REFERENCE_SEED + number)
            first, second = found.halves
            layers = {"": found.radiance, "first": first, "second": second, "error": found.errors}
            write_exr(file, layers)
        work.of("references")(number + 1, self.settings.views)
        channels = read_exr(file)
        image = lambda prefix: np.stack([channels[prefix + c] for c in "RGB"], axis=-1)  # noqa: E731
        return Reference(image(""), (image("first."), image("second.")), channels["error.V"])

    def _samples(self) -> NDArray[np.int64]:
        """(H * W,) samples of each of a reference's pixels."""
        settings = self.settings
        samples = np.full(settings.width * settings.height, settings.reference_spp, dtype=np.int64)
        samples[settings.frame.foveation.region(settings.width, settings.height).pixels] *= FOVEAL_REFERENCE
        return samples

    def _errors(self, number: int, found: Reference) -> list[dict[str, Any]]:
        """What is left of error in a reference, in dB, by region."""
        parts = regions(self.settings.frame.foveation, found.radiance)
        return [{"view": number, "region": n, "psnr": found.psnr(part.mask)} for n, part in parts.items()]

    def _entries(self, views: list[Camera], work: _Work) -> list[Entry]:
        settings = self.settings
        ours = hybrid_entries(self.renderer, settings)
        best = next(entry for entry in ours if entry.name == OURS)
        rays = best.method.rays(views[0], settings.frame.gaze)
        tuning = Tuning.restored(self.journal.once("tuning", lambda: asdict(self._tuning(views, rays, work))))
        arguments = self.tracer, tuning, views[0], settings.frame.gaze, self.costs, work.of("costs")
        return [*ours, *splat_entries(self.splats, self.flat), *baseline_entries(best, *arguments)]

    def _tuning(self, views: list[Camera], rays: float, work: _Work) -> Tuning:
        settings = self.settings
        size = settings.width // _TUNING_REDUCTION, settings.height // _TUNING_REDUCTION
        small = [camera.resized(*size) for camera in views[settings.views :]]
        seed = REFERENCE_SEED + settings.views
        truths = [
            reference(self.tracer, camera, settings.reference_spp, seed + number).radiance
            for number, camera in enumerate(small)
        ]
        return tuned(self.tracer, small, truths, settings.frame.foveation, rays, work.of("tuning"))


class _Work:
    """How much of all kinds of work is done."""

    def __init__(self, settings: EvaluationSettings, report: Callable[[str, float, float], None]):
        samples = settings.width * settings.height * settings.reference_spp
        steps = {
            "references": settings.views * samples,
            "tuning": 1,
            "costs": 1,
            "quality": settings.views,
            "times": settings.repeats,
        }
        self._weight = {name: steps[name] * _COSTS[name] for name in steps}
        self._done = dict.fromkeys(steps, 0.0)
        self._report = report

    def of(self, kind: str) -> Callable[[int, int], None]:
        """To be called with steps done and steps in all of one kind of work."""

        def progress(done: int, total: int) -> None:
            self._done[kind] = self._weight[kind] * done / total
            self._report(kind, sum(self._done.values()), sum(self._weight.values()))

        return progress
