"""The evaluation of a scene, view by view: all methods at equal cost, their quality and their times."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
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
from hybrid.base.identity import Journal, machine, measured_identity, require_scene, short_hash
from hybrid.base.parts import Part, begin, first_come, machine_of, parts_in
from hybrid.base.progress import no_progress
from hybrid.evaluation.ablations import ablations
from hybrid.evaluation.baselines import Tuning, families
from hybrid.evaluation.entries import (
    Entry,
    EvaluatedView,
    Scored,
    baseline_entries,
    hybrid_entries,
    quality_rows,
    splat_entries,
    time_rows,
    timed,
)
from hybrid.evaluation.equal_cost import rays_at_equal_time, tuned
from hybrid.evaluation.evaluation_settings import FOVEAL_REFERENCE, TUNING_REDUCTION, EvaluationSettings
from hybrid.evaluation.methods import HybridMethod, SplatsAlone
from hybrid.evaluation.results import BEYOND, EQUAL_RAYS, NEAR, OURS, WIDE, Key
from hybrid.evaluation.scoring import scorers
from hybrid.evaluation.verdicts import verdict_rows
from hybrid.measure.frame_quality import installed
from hybrid.measure.image_metrics import regions
from hybrid.measure.reference import REFERENCE_SEED, Reference, reference
from hybrid.render.forest_attachments import plan_of_forest, scene_as_trained, seconds_of, views_of
from hybrid.render.frame_renderer import Renderer
from hybrid.render.image_files import read_exr, write_exr
from hybrid.render.irradiance import filled_cache
from hybrid.render.periphery import Periphery
from pathtrace.region.neighbourhood import unseen_views, views_beyond, wider
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator
from splat.io.forest_file import load_forest
from splat.model.forest import Forest

# Views to tune baselines on, in addition to the measured ones.
_TUNING_VIEWS = 2
# Views of each kind whose images are kept and shown.
_SHOWN = {NEAR: 3, BEYOND: 1, WIDE: 1}
# Names in the journal: of what concerns all views, of the tuning, and of each view; the file.
_HEAD, _TUNING, _VIEW, _JOURNAL = "head", "tuning", "view ", "journal.json"
_SECONDS = "seconds"
# Shares of a view's work.
_SHARES = {"reference": 0.25, "equal time": 0.2, "quality": 0.35, "times": 0.2}


class Evaluation:
    """Evaluates one scene with one forest, view by view; resumes if interrupted.

    The report's folder gets images and the journal, of which each part has its own. `flat`, Gaussians without
    trees, are a further baseline. UserError if a forest belongs to another scene, the folder holds another
    evaluation, or a part does not fit to the others.
    """

    def __init__(
        self,
        scene: Scene,
        forest: Forest,
        settings: EvaluationSettings,
        folder: Path,
        flat: Forest | None = None,
        part: Part | None = None,
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
        self._flat_seconds = None if flat is None else seconds_of(flat)
        identity = measured_identity(
            scene,
            forest,
            display=asdict(settings.frame.display),
            settings=settings.as_json(),
            metrics=installed(),
            **{"baseline forest": None if flat is None else flat.digest()},
        )
        self.part = None if part is None else begin(folder, "evaluate", part, identity)
        self.work = folder / "work" if self.part is None else self.part.folder
        self.journal = Journal(self.work / _JOURNAL, identity if self.part is None else self.part.identity)
        # Rays at equal time are searched for once per machine and code, so that later runs compare the same
        # frames. Whether times are equal is measured in each run (`over_ours` in hybrid.evaluation.entries).
        file = scene_folder(scene.name, scene.hash) / f"costs-{short_hash(identity)}.json"
        self.costs = Journal(file, identity)

    def run(self, progress: Callable[[str, float, float], None]) -> dict[str, Any]:
        """The content of evaluation.json; `progress` gets the activity, work done and work in total.

        Of a part, the views are those of the part alone.
        """
        # First of all, so that whatever is written to the folder belongs to an evaluation.
        self.journal.write()
        views, tuning_views = self._views()
        self.journal.once(_HEAD, self._head)
        tuning = Tuning.restored(self._tuning(tuning_views))
        numbers = [n for n in range(len(views)) if self.part is None or self.part.part.takes(n)]
        with scorers() as scored:
            for place, number in enumerate(numbers):
                work = partial(_report, progress, place, len(numbers))
                make = partial(self._view, number, views, tuning, scored, work)
                self.journal.once(_VIEW + str(number), make)
        if self.part is not None:
            self.part.finish(tuning=asdict(tuning))
        return _content([self.journal], machine())

    def _views(self) -> tuple[list[tuple[str, View]], list[View]]:
        """Kinds and views to measure, unknown to training, and views to tune baselines on."""
        settings = self.settings
        size = settings.width, settings.height
        near = unseen_views(self.scene, settings.views + _TUNING_VIEWS, *size)
        apart = 0 if settings.quick else settings.apart
        beyond = views_beyond(self.scene, views_of(self.forest), apart, *size)
        wide = [wider(view) for view in near[: min(apart, settings.views)]]
        of_kind = {NEAR: near[: settings.views], BEYOND: beyond, WIDE: wide}
        return [(kind, view) for kind, views in of_kind.items() for view in views], near[settings.views :]

    def _head(self) -> dict[str, Any]:
        """What is said of the evaluation as a whole."""
        cached = self.settings.frame.used_integrator is Integrator.CACHED
        start = time.perf_counter()
        if cached:
            filled_cache(self.scene)
        return {
            "scene": self.scene.name,
            "settings": self.settings.as_json(),
            "display": asdict(self.settings.frame.display),
            "plan": plan_of_forest(self.forest),
            _SECONDS: {
                "forest": seconds_of(self.forest),
                "baseline forest": self._flat_seconds,
                "cache": time.perf_counter() - start if cached else 0.0,
            },
        }

    def _view(
        self, number: int, views: list[tuple[str, View]], tuning: Tuning, scored: Scored, work: Work
    ) -> dict[str, Any]:
        """Everything that is measured in a view, as the journal keeps it."""
        settings, (kind, view) = self.settings, views[number]
        truth = self._reference(number, view)
        work("reference", 1, 1)
        parts = regions(settings.frame.foveation, truth.radiance)
        before = [one for one, _ in views[:number]].count(kind)
        at = EvaluatedView(number, kind, view, truth, parts, settings, before < _SHOWN[kind])
        entries = self._entries(at, tuning, work)
        gaze = settings.frame.gaze
        return {
            "view": {"view": number, "kind": kind, "time": view.time},
            # PSNR against the truth, in dB.
            "references": [
                {"view": number, "region": name, "psnr": truth.psnr(part.mask)}
                for name, part in parts.items()
            ],
            "methods": [
                {
                    "method": entry.name,
                    "budget": entry.budget,
                    "rays": entry.method.rays(view.camera, gaze),
                    **entry.method.settings,
                }
                for entry in entries
            ],
            "quality": quality_rows(entries, at, self.folder, scored, partial(work, "quality")),
            "times": timed(entries, at, partial(work, "times")),
        }

    def _reference(self, number: int, view: View) -> Reference:
        """The reference of a view, from its file if there is one."""
        samples, seed = reference_samples(self.settings), REFERENCE_SEED + number
        size = view.camera.width, view.camera.height
        make = partial(reference, self.tracer, view.camera, samples, seed, self.settings.denoised_references)
        self.scene.show(view.time)
        return stored_reference(self.work / f"reference-{number}.exr", make, size)

    def _entries(self, at: EvaluatedView, tuning: Tuning, work: Work) -> list[Entry]:
        gaze, view = self.settings.frame.gaze, at.view
        hybrid = hybrid_entries(self.renderer, self.settings)
        ours = next(entry for entry in hybrid if entry.name == OURS).method
        # Rays depend on the shape of frames.
        frame = replace(self.settings.frame, camera=view.camera)
        traced = families(self.renderer, frame, tuning)
        without = {} if self.settings.quick else ablations(self.renderer, frame)
        known = traced | without
        rays = ours.rays(view.camera, gaze)
        # Views take about as long as those before them.
        before = [self.costs[str(number)] for number in range(at.number) if str(number) in self.costs]
        first = {name: next((c[name] for c in reversed(before) if c[name]), rays) for name in known}
        find = partial(rays_at_equal_time, known, ours, view, gaze, first, partial(work, "equal time"))
        met = self.costs.once(str(at.number), find)
        baselines = baseline_entries(traced, met, rays, view.camera, gaze)
        if self.settings.quick:
            baselines = [entry for entry in baselines if entry.budget != EQUAL_RAYS]
        baselines += [
            replace(entry, briefly=True)
            for entry in baseline_entries(without, met, rays, view.camera, gaze)
            if entry.budget != EQUAL_RAYS
        ]
        return [*hybrid, *splat_entries(self.splats, self.flat), *baselines]

    def _tuning(self, views: list[View]) -> dict[str, Any]:
        """What baselines are tuned to, as the journal keeps it; all parts have the same."""
        if self.part is None:
            return dict(self.journal.once(_TUNING, partial(self._tuned, views)))
        with first_come(self.folder) as common:
            journal = Journal(common / _JOURNAL, self.part.identity)
            return dict(journal.once(_TUNING, partial(self._tuned, views)))

    def _tuned(self, views: list[View]) -> dict[str, Any]:
        settings = self.settings
        size = settings.width // TUNING_REDUCTION, settings.height // TUNING_REDUCTION
        small = [view.resized(*size) for view in views]
        seed = REFERENCE_SEED - len(views)
        truths = []
        for number, view in enumerate(small):
            self.scene.show(view.time)
            truths.append(reference(self.tracer, view.camera, settings.reference_spp, seed + number).radiance)
        ours = HybridMethod(self.renderer, settings.frame)
        rays = ours.rays(views[0].camera, settings.frame.gaze)
        foveation = settings.frame.foveation
        return asdict(tuned(self.baseline_tracer, small, truths, foveation, rays, no_progress))


def evaluation_of(
    scene: Scene,
    forest: Forest,
    settings: EvaluationSettings | None,
    folder: Path,
    baseline_forest: Path | None,
    part: Part | None = None,
) -> Evaluation:
    """The evaluation of a scene as a forest was trained for it, ready to run; default settings if None.

    UserError also if the settings cannot be measured.
    """
    settings = settings or EvaluationSettings()
    settings.require_measurable()
    scene, flat = scene_as_trained(scene, forest), None
    if baseline_forest is not None:
        flat = load_forest(baseline_forest)
        require_scene(flat, scene.name, scene.hash, baseline_forest)
    return Evaluation(scene, forest, settings, folder, flat, part)


def merged_evaluation(folder: Path) -> dict[str, Any]:
    """The content of evaluation.json of an evaluation whose parts are in a folder, with its images.

    UserError as `parts_in` raises it, or if results of a complete part are gone.
    """
    parts = parts_in(folder)
    # The tuning was not known yet when they began.
    begun = [{name: value for name, value in one.identity.items() if name != _TUNING} for one in parts]
    journals = [Journal(one.folder / _JOURNAL, own) for one, own in zip(parts, begun, strict=True)]
    for one, journal in zip(parts, journals, strict=True):
        if _HEAD not in journal:
            raise UserError(f"{one.folder / _JOURNAL}: is missing; remove {one.folder.name} and run it again")
    return _content(journals, machine_of(parts))


def _content(journals: Sequence[Journal], made_with: dict[str, Any]) -> dict[str, Any]:
    """The content of evaluation.json from the journals of all parts."""
    head = dict(journals[0][_HEAD])
    seconds, settings = head.pop(_SECONDS), head["settings"]
    views = [found for one in journals for name, found in one.items() if name.startswith(_VIEW)]
    views.sort(key=lambda found: found["view"]["view"])
    times = time_rows([found["times"] for found in views], settings["width"], settings["height"])
    content: dict[str, Any] = {
        **head,
        "views": [found["view"] for found in views],
        "references": [row for found in views for row in found["references"]],
        "methods": mean_rows([found["methods"] for found in views]),
        "quality": [row for found in views for row in found["quality"]],
        "time": times,
        "preparation": preparation_rows(times, seconds, settings["integrator"]),
        "machine": made_with,
    }
    return {**content, "verdicts": verdict_rows(content)}


def preparation_rows(
    times: Sequence[Mapping[str, Any]], seconds: Mapping[str, float | None], integrator: str
) -> list[dict[str, Any]]:
    """Rows of method, the seconds of its preparation, and the number of frames after which it has paid.

    It pays against denoised unbiased frames of a sample per pixel, which need no preparation. None where the
    seconds are not known, or a frame takes no less.
    """
    path = Integrator.PATH.value
    full = "full, denoised" if integrator == path else f"full, {path}, denoised"
    slowest = max((row["ms"]["p50"] for row in times if row["method"] == full), default=0.0)
    rows: list[dict[str, Any]] = []
    for row in {row["method"]: row for row in times}.values():
        words = row["method"].split(", ")
        if words[0] in ("hybrid", "splats alone"):
            needed = seconds["forest"]
        elif words[0] == "3dgs":
            needed = seconds["baseline forest"]
        else:
            needed = 0.0 if path in words else seconds["cache"]
        saved = slowest - row["ms"]["p50"]
        pays = needed is not None and saved > 0
        frames = math.ceil(1000 * needed / saved) if pays and needed is not None else None
        rows.append({"method": row["method"], "seconds": needed, "frames_to_pay": frames})
    return rows


# Called with the activity, of those in _SHARES, steps done and steps in total.
Work = Callable[[str, int, int], None]


def _report(
    progress: Callable[[str, float, float], None],
    number: int,
    count: int,
    activity: str,
    done: int,
    total: int,
) -> None:
    """Reports the progress of one of several views, in views."""
    before = sum(_SHARES[name] for name in list(_SHARES)[: list(_SHARES).index(activity)])
    progress(f"view {number + 1}: {activity}", number + before + _SHARES[activity] * done / total, count)


def mean_rows(by_view: Sequence[Sequence[Mapping[str, Any]]]) -> list[dict[str, Any]]:
    """One row per method and budget: what is the same in all views, and means of numbers that are not."""
    rows: dict[Key, list[Mapping[str, Any]]] = {}
    for row in (row for view in by_view for row in view):
        rows.setdefault(Key.of(row), []).append(row)
    return [
        {
            name: value
            if len({one[name] for one in same}) == 1
            else float(np.mean([one[name] for one in same]))
            for name, value in same[0].items()
        }
        for same in rows.values()
    ]


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
