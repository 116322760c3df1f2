"""The evaluation of a scene: all methods at equal cost, their quality and their times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import View
from compose.image.colour import Image
from hybrid.base.cache_folder import scene_folder
from hybrid.base.compute_device import device_arrays
from hybrid.base.identity import Journal, machine, measured_identity, short_hash
from hybrid.base.progress import Steps
from hybrid.evaluation.ablations import ablations
from hybrid.evaluation.baselines import Tuning, families
from hybrid.evaluation.entries import (
    Entry,
    baseline_entries,
    evaluated_views,
    hybrid_entries,
    quality_rows,
    splat_entries,
    time_rows,
)
from hybrid.evaluation.equal_cost import tuned
from hybrid.evaluation.evaluation_settings import FOVEAL_REFERENCE, TUNING_REDUCTION, EvaluationSettings
from hybrid.evaluation.methods import SplatsAlone
from hybrid.evaluation.results import OURS
from hybrid.measure.reference import REFERENCE_SEED, Reference, reference
from hybrid.render.forest_attachments import plan_of_forest
from hybrid.render.frame_renderer import Renderer
from hybrid.render.image_files import read_exr, write_exr
from hybrid.render.periphery import Periphery
from pathtrace.region.neighbourhood import unseen_views
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Views to tune baselines on, in addition to the measured ones.
_TUNING_VIEWS = 2
# Approximate milliseconds per step of each kind of work, from which the time left is estimated: per sample of
# a reference, in total, in total, per view, and per round of frames.
_COSTS = {"references": 4e-3, "tuning": 44e3, "costs": 72e3, "quality": 63e3, "times": 2.5e3}


class Evaluation:
    """Evaluates one scene with one forest; resumes if interrupted.

    The report's folder gets images and the journal. `flat`, Gaussians without trees, are a further baseline.
    UserError if a forest belongs to another scene, or the folder holds another evaluation.
    """

    def __init__(
        self, scene: Scene, forest: Forest, settings: EvaluationSettings, folder: Path, flat: Forest | None
    ):
        # All methods trace in the same way, raw foveas as well; only references are always unbiased.
        integrator = settings.frame.used_integrator
        settings = replace(settings, frame=replace(settings.frame, integrator=integrator))
        self.renderer, self.forest = Renderer(scene, forest), forest
        # As the forest was trained for it.
        self.scene = scene = self.renderer.scene
        self.settings, self.folder = settings, folder
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
        # frames. Whether times are equal is measured in each run (`over_ours` in hybrid.evaluation.entries).
        file = scene_folder(scene.name, scene.hash) / f"costs-{short_hash(identity)}.json"
        self.costs = Journal(file, identity)

    def run(self, progress: Callable[[str, float, float], None]) -> dict[str, Any]:
        """The content of evaluation.json; `progress` gets the activity, work done and work in total."""
        settings = self.settings
        # First of all, so that whatever is written to the folder belongs to an evaluation.
        self.journal.write()
        work = WorkProgress(settings, progress)
        # Near the scene's own view, and unknown to training; the last ones are for tuning.
        count = settings.views + _TUNING_VIEWS
        views = unseen_views(self.scene, count, settings.width, settings.height)
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
                # PSNR against the truth, in dB.
                {"view": view.number, "region": name, "psnr": view.reference.psnr(part.mask)}
                for view in evaluated
                for name, part in view.regions.items()
            ],
            "methods": [
                {
                    "method": entry.name,
                    "budget": entry.budget,
                    "rays": entry.method.rays(views[0].camera, gaze),
                    **entry.method.settings,
                }
                for entry in entries
            ],
            "quality": quality,
            "time": times,
            "plan": plan_of_forest(self.forest),
            "machine": machine(),
        }

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
        gaze = self.settings.frame.gaze
        hybrid = hybrid_entries(self.renderer, self.settings)
        ours = next(entry for entry in hybrid if entry.name == OURS)
        rays = ours.method.rays(views[0].camera, gaze)
        tuning = Tuning.restored(self.journal.once("tuning", lambda: asdict(self._tuning(views, rays, work))))
        views, progress = views[: self.settings.views], work.of("costs")
        # Rays depend on the shape of frames.
        frame = replace(self.settings.frame, camera=views[0].camera)
        known = families(self.renderer, frame, tuning) | ablations(self.renderer, frame)
        baselines = baseline_entries(ours, known, views, gaze, self.costs, progress)
        return [*hybrid, *splat_entries(self.splats, self.flat), *baselines]

    def _tuning(self, views: list[View], rays: float, work: WorkProgress) -> Tuning:
        settings = self.settings
        size = settings.width // TUNING_REDUCTION, settings.height // TUNING_REDUCTION
        small = [view.resized(*size) for view in views[settings.views :]]
        seed = REFERENCE_SEED + settings.views
        truths = []
        for number, view in enumerate(small):
            self.scene.show(view.time)
            truths.append(reference(self.tracer, view.camera, settings.reference_spp, seed + number).radiance)
        return tuned(self.baseline_tracer, small, truths, settings.frame.foveation, rays, work.of("tuning"))


class WorkProgress:
    """Adds up the progress of all kinds of work, weighted by what they take, and reports it."""

    def __init__(self, settings: EvaluationSettings, report: Callable[[str, float, float], None]):
        views, samples = settings.views, settings.width * settings.height * settings.reference_spp
        steps = (views * samples, 1, 1, views, settings.repeats)
        self._weight = {name: n * cost for n, (name, cost) in zip(steps, _COSTS.items(), strict=True)}
        self._done = dict.fromkeys(_COSTS, 0.0)
        self._report = report

    def of(self, kind: str) -> Steps:
        """The progress callback of one kind of work: called with steps done and steps in total."""

        def progress(done: int, total: int) -> None:
            self._done[kind] = self._weight[kind] * done / total
            self._report(kind, sum(self._done.values()), sum(self._weight.values()))

        return progress


def reference_samples(settings: EvaluationSettings) -> NDArray[np.int64]:
    """(H * W,) samples of each pixel: FOVEAL_REFERENCE times as many in the disc."""
    samples = np.full(settings.width * settings.height, settings.reference_spp, dtype=np.int64)
    samples[settings.frame.foveation.region(settings.width, settings.height).pixels] *= FOVEAL_REFERENCE
    return samples


def stored_reference(
    file: Path, make: Callable[[], Reference], size: tuple[int, int] | None = None
) -> Reference:
    """The reference in an EXR file; made and written now if there is none, or it is damaged.

    Its width and height must be `size`, if that is given. UserError if the file cannot be written.
    """
    try:
        return _reference(read_exr(file, size))
    except (UserError, KeyError):
        made = make()
        first, second = made.halves
        write_exr(file, {"": made.radiance, "first": first, "second": second, "error": made.errors})
        return _reference(read_exr(file, size))


def _reference(channels: dict[str, NDArray[np.float32]]) -> Reference:
    """The reference of what `stored_reference` writes; KeyError if a channel is missing."""

    def image(prefix: str) -> Image:
        return np.stack([channels[prefix + channel] for channel in "RGB"], axis=-1)

    return Reference(image(""), (image("first."), image("second.")), channels["error.V"])
