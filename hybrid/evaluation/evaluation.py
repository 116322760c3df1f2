"""The evaluation of a scene: all methods at equal cost, their quality and their times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from compose.camera.camera import Camera
from compose.camera.view import View
from hybrid.evaluation.entries import Entry, baseline_entries, hybrid_entries, splat_entries
from hybrid.evaluation.families import Tuning
from hybrid.evaluation.keys import OURS
from hybrid.evaluation.quality import evaluated_views, quality_rows
from hybrid.evaluation.references import reference_errors, reference_samples, stored_reference
from hybrid.evaluation.settings import TUNING_REDUCTION, EvaluationSettings
from hybrid.evaluation.times import time_rows
from hybrid.evaluation.tuning import tuned
from hybrid.evaluation.work import WorkProgress
from hybrid.frame.periphery import Periphery
from hybrid.frame.renderer import Renderer
from hybrid.measure.reference import REFERENCE_SEED, Reference, reference
from hybrid.methods.splats import SplatsAlone
from hybrid.plan.values import plan_of_forest
from hybrid.runtime.device import device_arrays
from hybrid.runtime.machine import machine
from hybrid.store.cache import scene_folder
from hybrid.store.identity import measured_identity, short_hash
from hybrid.store.journal import Journal
from pathtrace.dataset.views import unseen_views
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Views to tune baselines on, in addition to the measured ones.
_TUNING_VIEWS = 2


class Evaluation:
    """Evaluates one scene with one forest; resumes if interrupted.

    Args:
        scene, forest: what is rendered.
        settings: what to measure.
        folder: of the report, for images and the journal.
        flat: Gaussians without trees as a further baseline; None leaves it out.

    Raises:
        UserError: a forest belongs to another scene, or the folder holds another evaluation.
    """

    def __init__(
        self,
        scene: Scene,
        forest: Forest,
        settings: EvaluationSettings,
        folder: Path,
        flat: Forest | None = None,
    ):
        # All methods trace in the same way, raw foveas as well; only references are always unbiased.
        integrator = settings.frame.used_integrator
        settings = replace(settings, frame=replace(settings.frame, integrator=integrator))
        self.scene, self.settings, self.folder = scene, settings, folder
        self.renderer, self.forest = Renderer(scene, forest), forest
        self.tracer, self.baseline_tracer = self.renderer.tracer, self.renderer.tracer_of(integrator)
        self.splats = SplatsAlone(Periphery(device_arrays(), forest))
        self.flat = None if flat is None else SplatsAlone(Periphery(device_arrays(), flat))
        identity = measured_identity(
            scene,
            forest,
            display=asdict(settings.frame.display),
            settings=settings.as_json(),
            **{"baseline forest": None if flat is None else flat.digest()},
        )
        self.journal = Journal(folder / "work" / "journal.json", identity)
        # Rays at equal time are searched for once per machine and code, so that later runs compare the same
        # frames. Whether times are equal is measured in each run (`over_ours` in hybrid.evaluation.times).
        file = scene_folder(scene.name, scene.hash) / f"costs-{short_hash(identity)}.json"
        self.costs = Journal(file, identity)

    def run(self, progress: Callable[[str, float, float], None]) -> dict[str, Any]:
        """Measures what is not measured yet, and returns the content of evaluation.json.

        Args:
            progress: called with the current activity, work done and work in total.
        """
        settings = self.settings
        # First of all, so that whatever is written to the folder belongs to an evaluation.
        self.journal.write()
        work = WorkProgress(settings, progress)
        views = self._views()
        measured = views[: settings.views]
        references = [self._reference(number, view, work) for number, view in enumerate(measured)]
        entries = self._entries(views, work)
        evaluated = evaluated_views(measured, references, settings, self.folder)
        quality = quality_rows(entries, evaluated, self.journal, work.of("quality"))
        gaze, repeats = settings.frame.gaze, settings.repeats
        times = time_rows(entries, measured, gaze, repeats, self.journal, work.of("times"))
        return {
            "scene": self.scene.name,
            "settings": settings.as_json(),
            "display": asdict(settings.frame.display),
            "times": [view.time for view in measured],
            "references": [
                row
                for number, found in enumerate(references)
                for row in reference_errors(settings, number, found)
            ],
            "methods": [self._method_row(entry, views[0].camera) for entry in entries],
            "quality": quality,
            "time": times,
            "plan": plan_of_forest(self.forest),
            "machine": machine(),
        }

    def _views(self) -> list[View]:
        """Views near the scene's own, which training has not seen; the last ones are for tuning."""
        settings = self.settings
        return unseen_views(self.scene, settings.views + _TUNING_VIEWS, settings.width, settings.height)

    def _reference(self, number: int, view: View, work: WorkProgress) -> Reference:
        """The reference of a view, from its file if there is one."""
        samples, seed = reference_samples(self.settings), REFERENCE_SEED + number
        size = view.camera.width, view.camera.height
        make = partial(reference, self.tracer, view.camera, samples, seed)
        self.scene.show(view.time)
        found = stored_reference(self.folder / "work" / f"reference-{number}.exr", make, size)
        work.of("references")(number + 1, self.settings.views)
        return found

    def _entries(self, views: list[View], work: WorkProgress) -> list[Entry]:
        """All methods at all budgets."""
        gaze = self.settings.frame.gaze
        hybrid = hybrid_entries(self.renderer, self.settings)
        ours = next(entry for entry in hybrid if entry.name == OURS)
        rays = ours.method.rays(views[0].camera, gaze)
        tuning = Tuning.restored(self.journal.once("tuning", lambda: asdict(self._tuning(views, rays, work))))
        baselines = baseline_entries(
            ours,
            self.baseline_tracer,
            tuning,
            views[: self.settings.views],
            gaze,
            self.costs,
            work.of("costs"),
        )
        return [*hybrid, *splat_entries(self.splats, self.flat), *baselines]

    def _tuning(self, views: list[View], rays: float, work: WorkProgress) -> Tuning:
        """Settings of the baselines, found on smaller versions of the views for tuning."""
        settings = self.settings
        size = settings.width // TUNING_REDUCTION, settings.height // TUNING_REDUCTION
        small = [view.resized(*size) for view in views[settings.views :]]
        seed = REFERENCE_SEED + settings.views
        truths = []
        for number, view in enumerate(small):
            self.scene.show(view.time)
            truth = reference(self.tracer, view.camera, settings.reference_spp, seed + number)
            truths.append(truth.radiance)
        return tuned(self.baseline_tracer, small, truths, settings.frame.foveation, rays, work.of("tuning"))

    def _method_row(self, entry: Entry, camera: Camera) -> dict[str, Any]:
        """An entry with its rays and settings."""
        rays = entry.method.rays(camera, self.settings.frame.gaze)
        return {"method": entry.name, "budget": entry.budget, "rays": rays, **entry.method.settings}
