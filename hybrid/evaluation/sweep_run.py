"""Runs a sweep from its name to its rows of times and quality; resumes if interrupted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from hybrid.base.cache_folder import scene_folder
from hybrid.base.identity import Journal, machine, measured_identity, short_hash
from hybrid.base.parts import Part, StoredPart, begin, machine_of, parts_in
from hybrid.base.progress import Steps
from hybrid.evaluation.baselines_traced import FullTrace
from hybrid.evaluation.measured_settings import MeasuredSettings, MeasuredStore
from hybrid.evaluation.methods import HybridMethod, Method
from hybrid.evaluation.sweep_catalogue import Setting, Sweep, SweepEffort, break_even, sweep_named
from hybrid.measure.frame_quality import Viewer, metric_rows, missing
from hybrid.measure.frame_times import (
    covered,
    interleaved_passes,
    jittered_view,
    medians_by_view,
    percentiles,
    ratio_interval,
    ratio_of_medians,
    reach_for,
)
from hybrid.measure.image_metrics import ImageRegion, plain_regions
from hybrid.measure.reference import REFERENCE_SEED, Reference, reference
from hybrid.render.frame_renderer import Renderer
from pathtrace.region.neighbourhood import unseen_views
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Number of views that the sweep over views has, and in how many the rows of the others are measured.
_VIEWS, _JUDGED = 4, 3
# Regions whose quality is measured.
_REGIONS = ("whole", "foveal", "peripheral")
# Metrics in which target qualities may be given; the first one that was measured is used.
_TARGET_METRICS = ("jod", "ssim")
# The file of a part's rows, and what is there beside them.
_ROWS, _HEAD = "rows.json", "head"
# Milliseconds per pass, frame by frame.
Frames = list[dict[str, float]]


def sweep(
    scene: Scene,
    forest: Forest,
    over: str,
    base: Setting,
    effort: SweepEffort,
    write: Callable[[dict[str, Any]], None],
    progress: Steps,
) -> dict[str, Any]:
    """Times hybrid frames and full path tracing in turns, over one quantity, from a base setting.

    Frames are timed, and their quality is measured, in three views that nothing was fitted to; a row of the
    sweep over views is one such view. The result is written before the intermediate results are deleted.
    Progress counts in thousandths of a row.

    Returns scene, forest, over, title, views (in how many each row was measured), rows, break_even (of the
    sweep over the radius), the settings that all rows have in common, and machine. UserError if there is no
    such sweep, or if a region whose quality is measured is empty.
    """
    chosen, settings = _settings(scene, forest, over, base)
    identity = identity_of(scene, forest, chosen, settings, effort)
    folder = scene_folder(scene.name, scene.hash)
    journal = Journal(folder / f"sweep-{over}-{short_hash(identity)}.json", identity)
    rows = swept(scene, forest, settings, chosen.with_quality, effort, journal, progress)
    if over == "trade":
        _store_trade(scene, forest, settings, rows)
    empty = {**_head(scene, forest, over, base, effort, settings), "machine": machine()}
    content = with_rows(empty, rows)
    write(content)
    journal.remove()
    return content


def sweep_part(
    scene: Scene,
    forest: Forest,
    over: str,
    base: Setting,
    effort: SweepEffort,
    place: tuple[Path, Part],
    progress: Steps,
) -> StoredPart:
    """Measures the rows of one part of a sweep, for `merged_sweep`: whole groups of one view and size.

    The place is the folder that all parts share, and the part. Progress and errors are those of `sweep`, and
    those of `begin`.
    """
    chosen, settings = _settings(scene, forest, over, base)
    stored = begin(place[0], "sweep", place[1], identity_of(scene, forest, chosen, settings, effort))
    journal = Journal(stored.folder / _ROWS, stored.identity)
    journal.once(_HEAD, lambda: _head(scene, forest, over, base, effort, settings))
    takes = stored.part.takes
    rows = swept(scene, forest, settings, chosen.with_quality, effort, journal, progress, takes)
    # All of its rows are of one group.
    if over == "trade" and rows:
        _store_trade(scene, forest, settings, rows)
    stored.finish()
    return stored


def merged_sweep(shared: Path) -> dict[str, Any]:
    """What `sweep` returns, of the parts in a folder; of several machines, it says all that they have.

    UserError as `parts_in` raises it, or if rows of a complete part are gone.
    """
    parts, head = parts_in(shared), {}
    by_group: dict[int, list[dict[str, Any]]] = {}
    for one in parts:
        results = dict(Journal(one.folder / _ROWS, one.identity))
        if not (head := results.pop(_HEAD, {})):
            raise UserError(f"{one.folder / _ROWS}: is missing; remove {one.folder.name} and run it again")
        by_group |= {int(number): rows for number, rows in results.items()}
    return with_rows(
        {**head, "machine": machine_of(parts)},
        [row for number in sorted(by_group) for row in by_group[number]],
    )


def with_rows(content: dict[str, Any], rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The content of a sweep's JSON with its rows, and what follows from them."""
    found = break_even(rows) if content["over"] == "radius" else []
    return {**content, "rows": rows, "break_even": found}


def _settings(scene: Scene, forest: Forest, over: str, base: Setting) -> tuple[Sweep, list[Setting]]:
    """The sweep of a name, and its rows with their views."""
    chosen = sweep_named(over, forest.counts)
    views = unseen_views(scene, _VIEWS, base.camera.width, base.camera.height)
    settings = chosen.settings(base, views)
    if not chosen.over_views:
        settings = [setting.from_views(views[:_JUDGED]) for setting in settings]
    return chosen, settings


def _store_trade(scene: Scene, forest: Forest, settings: list[Setting], rows: list[dict[str, Any]]) -> None:
    """Stores what target times and target qualities choose from."""
    metric = next(name for name in _TARGET_METRICS if f"whole {name}" in rows[0]["quality"])
    measured = []
    for setting, row in zip(settings, rows, strict=True):
        quality, between = (row[of][f"whole {metric}"] for of in ("quality", "quality_range"))
        measured.append(MeasuredSettings(setting.frame, row["ms"]["p50"], quality, tuple(between)))
    camera, frame = settings[0].camera, replace(settings[0].frame, camera=None)
    MeasuredStore("trade", scene, forest, (camera.width, camera.height), frame).save(metric, measured)


def _head(
    scene: Scene, forest: Forest, over: str, base: Setting, effort: SweepEffort, settings: list[Setting]
) -> dict[str, Any]:
    """The content of a sweep's JSON, but its rows and the machine."""
    chosen = sweep_named(over, forest.counts)
    return {
        "scene": scene.name,
        "forest": forest.digest(),
        "over": over,
        "title": chosen.title,
        "views": len(settings[0].seen),
        "rows": [],
        "break_even": [],
        **settings_of_row(chosen, base, effort),
    }


def swept(
    scene: Scene,
    forest: Forest,
    settings: list[Setting],
    with_quality: bool,
    effort: SweepEffort,
    journal: Journal,
    progress: Steps,
    takes: Callable[[int], bool] = lambda number: True,
) -> list[dict[str, Any]]:
    """One row per setting: the varied quantities, `ms` of hybrid and `full_ms` of full frames, their `ratio`.

    Rows of one view and size take turns with the full path-traced frame at each of their sample counts,
    denoised where the fovea is; `takes` says which of these groups are measured, by number. Their gazes
    follow the same path, on which the largest of their discs stays in the frame; `covered` is the mean
    fraction of the frame that a row's disc covers. Frames go through the views of a row in turn, each with a
    camera of its own, so that frames reuse nothing. `ms_range`, `ratio_range` and `quality_range` are those
    of the views' medians and values. `ratio_1spp` is the ratio to the full frame at one sample per pixel.
    Quality is measured with the gaze at the centre. UserError, before anything is measured, if a region whose
    quality is measured is empty.
    """
    if with_quality:
        for setting in settings:
            regions_of(setting)
    renderer = Renderer(scene, forest)
    rows: list[dict[str, Any]] = []
    by_view = groupby(settings, key=lambda one: [view.key for view in one.seen])
    groups = {number: list(group) for number, (_, group) in enumerate(by_view) if takes(number)}
    for number, same in groups.items():

        def advance(done: int, total: int, before: int = len(rows), count: int = len(same)) -> None:
            progress(1000 * before + 1000 * count * done // total, 1000 * sum(map(len, groups.values())))

        rows += journal.once(str(number), partial(_group, renderer, same, with_quality, effort, advance))
        advance(1, 1)
    return rows


def _group(
    renderer: Renderer, same: list[Setting], with_quality: bool, effort: SweepEffort, progress: Steps
) -> list[dict[str, Any]]:
    camera, views = same[0].camera, same[0].seen
    ours = [HybridMethod(renderer, setting.frame) for setting in same]
    # By samples per pixel and whether they are denoised.
    full = {
        (spp, one.is_denoised): FullTrace(renderer.tracer_of(one.frame.used_integrator), spp, one.is_denoised)
        for one in same
        for spp in (one.frame.spp, *((1,) if one.over_one_spp else ()))
    }
    methods: list[Method] = [*ours, *full.values()]

    def passes(place: int, gaze: Gaze, seed: int) -> dict[str, float]:
        # A camera of its own, because the shared renderer keeps what depends on a camera.
        view = jittered_view(views[seed % len(views)], len(methods) * seed + place)
        return methods[place].render(view, gaze, seed).milliseconds

    reach = reach_for(max(setting.frame.fov_a for setting in same), camera)
    timed = [partial(passes, place) for place in range(len(methods))]
    times = interleaved_passes(timed, effort.repeats, effort.warm_up, progress, reach)
    of_full = dict(zip(full, times[len(ours) :], strict=True))
    truths = []
    for number, view in enumerate(views if with_quality else ()):
        renderer.scene.show(view.time)
        truths.append(reference(renderer.tracer, view.camera, effort.reference_spp, REFERENCE_SEED + number))
    rows = []
    for setting, method, found in zip(same, ours, times, strict=False):
        row = _row(setting, found, of_full, effort)
        row["covered"] = covered(setting.frame.fov_a, camera, effort.repeats, reach)
        if truths:
            row["quality"], row["quality_range"] = quality_of(setting, method, truths)
        rows.append(row)
    return rows


def _row(
    setting: Setting, ours: Frames, full: dict[tuple[int, bool], Frames], effort: SweepEffort
) -> dict[str, Any]:
    """Times of a setting against those of full frames, by samples per pixel and whether they are denoised."""
    total = [frame["total"] for frame in ours]
    of_full = {of: [frame["total"] for frame in frames] for of, frames in full.items()}
    same = of_full[setting.frame.spp, setting.is_denoised]
    row: dict[str, Any] = {
        **setting.varied,
        "ms": percentiles(total),
        "full_ms": percentiles(same),
        "ratio": ratio_of_medians(same, total),
        "ratio_interval": ratio_interval(same, total),
        "passes": {n: float(np.median([f[n] for f in ours])) for n in ours[0] if n != "total"},
        "repeats": effort.repeats,
    }
    if len(setting.seen) > 1:
        times, of_views = (medians_by_view(found, len(setting.seen)) for found in (total, same))
        ratios = [over / under for over, under in zip(of_views, times, strict=True)]
        row |= {"ms_range": [min(times), max(times)], "ratio_range": [min(ratios), max(ratios)]}
    if setting.over_one_spp:
        row["ratio_1spp"] = ratio_of_medians(of_full[1, setting.is_denoised], total)
    return {**row, "paper": setting.paper} if setting.paper else row


def regions_of(setting: Setting) -> dict[str, ImageRegion]:
    """The regions of a row whose quality is measured, by name; UserError if one is empty."""
    size = setting.camera.height, setting.camera.width
    return plain_regions(replace(setting.frame, gaze=Gaze()).foveation, size, _REGIONS)


def quality_of(
    setting: Setting, method: HybridMethod, truths: list[Reference]
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Metrics of a row's frames by region and metric, such as "foveal jod", against those of its views.

    They are means over the views, with the least and the greatest value. A metric that has no value in one of
    the views is left out: its mean would be of other views than those of other rows.
    """
    viewer, parts = Viewer(setting.frame.display, Gaze()), regions_of(setting)
    found: dict[str, list[float]] = {}
    for seed, (view, truth) in enumerate(zip(setting.seen, truths, strict=True)):
        image = method.render(view, Gaze(), seed).image
        for row in metric_rows(image, truth.radiance, parts, viewer):
            found.setdefault(f"{row['region']} {row['metric']}", []).append(float(row["value"]))
    known = {name: values for name, values in found.items() if len(values) == len(truths)}
    ranges = {name: (min(values), max(values)) for name, values in known.items()}
    return {name: float(np.mean(values)) for name, values in known.items()}, ranges


def identity_of(
    scene: Scene, forest: Forest, sweep: Sweep, settings: list[Setting], effort: SweepEffort
) -> dict[str, Any]:
    """Everything that the rows of a sweep depend on."""
    rows = [
        {
            **vars(setting),
            "camera": setting.camera.key.hex(),
            "frame": setting.frame.as_json(),
            "views": [view.key.hex() for view in setting.views],
        }
        for setting in settings
    ]
    metrics = {"missing metrics": missing()} if sweep.with_quality else {}
    return measured_identity(
        scene, forest, settings=rows, quality=sweep.with_quality, effort=asdict(effort), **metrics
    )


def settings_of_row(sweep: Sweep, base: Setting, effort: SweepEffort) -> dict[str, Any]:
    """The settings that all rows have in common, without those that the sweep varies or ignores, as JSON."""
    frame = base.frame
    radii = {"fov_a": frame.fov_a, "fov_b": frame.fov_b}
    common = {
        "width": base.camera.width,
        "height": base.camera.height,
        "fovea": frame.fovea.value,
        **({"fov_b_of_fov_a": frame.fov_b / frame.fov_a} if sweep.scales_radii else radii),
        "spp": frame.spp,
        "acuity_model": frame.acuity_model,
        "reference_spp": effort.reference_spp,
    }
    ignored = {*sweep.ignored, *(("width", "height") if "size" in sweep.ignored else ())}
    varies = "fovea" in sweep.ignored and frame.integrator is None
    return {
        **{name: value for name, value in common.items() if name not in ignored},
        "integrator": "by fovea" if varies else frame.used_integrator.value,
        "display": asdict(frame.display),
    }
