"""Measures all rows of a sweep: their times and, if wanted, their quality."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from compose.camera.view import View
from compose.eye.gaze import Gaze
from hybrid.frame.renderer import Renderer
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.measure.timing import (
    interleaved_passes,
    jittered_view,
    medians_by_view,
    percentiles,
    ratio_interval,
    ratio_of_medians,
)
from hybrid.methods.hybrid import HybridMethod
from hybrid.methods.method import Method
from hybrid.methods.path_traced import FullTrace
from hybrid.store.journal import Journal
from hybrid.sweeps.coverage import covered, reach_for
from hybrid.sweeps.effort import Effort
from hybrid.sweeps.quality import quality_of, regions_of
from hybrid.sweeps.setting import Setting
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Milliseconds per pass, frame by frame.
Frames = list[dict[str, float]]


def swept(
    scene: Scene,
    forest: Forest,
    settings: list[Setting],
    with_quality: bool,
    effort: Effort,
    journal: Journal,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per setting: the varied quantities, `ms` of hybrid and `full_ms` of full frames, their `ratio`.

    Rows of one view and size take turns with the full path-traced frame at each of their sample counts,
    denoised where the fovea is. Their gazes follow the same path, on which the largest of their discs stays
    in the frame; `covered` is the mean fraction of the frame that a row's disc covers. Frames go through the
    views of a row in turn, and each has a camera of its own, so that frames reuse nothing. `ms_range`,
    `ratio_range` and `quality_range` are the least and the greatest value over the views, of medians where
    times are concerned.
    `ratio_1spp` is the ratio to the full frame at one sample per pixel, if a setting asks for it.

    Args:
        scene, forest: what is rendered.
        settings: the rows.
        with_quality: whether to measure quality as well, with the gaze at the centre.
        effort: how much is measured.
        journal: stores the rows of each view and size; those it holds are not measured again.
        progress: called with work done and work in total, in thousandths of a row.

    Raises:
        UserError: a region whose quality is measured is empty; raised before anything is measured.
    """
    if with_quality:
        for setting in settings:
            regions_of(setting)
    renderer = Renderer(scene, forest)
    rows: list[dict[str, Any]] = []
    for number, (_, group) in enumerate(groupby(settings, key=_view_keys)):
        same = list(group)
        done = partial(_advanced, progress, len(rows), len(same), len(settings))
        rows += journal.once(str(number), partial(_group, renderer, same, with_quality, effort, done))
        done(1, 1)
    return rows


def _group(
    renderer: Renderer,
    same: list[Setting],
    with_quality: bool,
    effort: Effort,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """Rows of the same views, which take turns."""
    camera, views, tracer = same[0].camera, same[0].seen, renderer.tracer
    ours = [HybridMethod(renderer, setting.frame) for setting in same]
    full = _full_traces(renderer, same)
    reach = reach_for(max(setting.frame.fov_a for setting in same), camera)
    times = _times([*ours, *full.values()], views, effort, progress, reach)
    of_full = dict(zip(full, times[len(ours) :], strict=True))
    judged = views if with_quality else ()
    truths = []
    for number, view in enumerate(judged):
        renderer.scene.show(view.time)
        truths.append(reference(tracer, view.camera, effort.reference_spp, REFERENCE_SEED + number))
    rows = []
    for setting, method, found in zip(same, ours, times, strict=False):
        row = _row(setting, found, of_full, effort)
        row["covered"] = covered(setting.frame.fov_a, camera, effort.repeats, reach)
        if truths:
            row["quality"], row["quality_range"] = quality_of(setting, method, truths)
        rows.append(row)
    return rows


def _full_traces(renderer: Renderer, settings: list[Setting]) -> dict[tuple[int, bool], FullTrace]:
    """The full path-traced frames to compare with, by samples per pixel and whether they are denoised."""
    wanted = [(setting, setting.frame.spp) for setting in settings]
    wanted += [(setting, 1) for setting in settings if setting.over_one_spp]
    return {
        (spp, one.is_denoised): FullTrace(renderer.tracer_of(one.frame.used_integrator), spp, one.is_denoised)
        for one, spp in wanted
    }


def _times(
    methods: list[Method],
    views: tuple[View, ...],
    effort: Effort,
    progress: Callable[[int, int], None],
    reach: tuple[float, float],
) -> list[Frames]:
    """Times of all methods, in turns, in one view after the other."""
    timed = [partial(_passes, method, views, len(methods), place) for place, method in enumerate(methods)]
    return interleaved_passes(timed, effort.repeats, effort.warm_up, progress, reach)


def _passes(
    method: Method, views: tuple[View, ...], methods: int, place: int, gaze: Gaze, seed: int
) -> dict[str, float]:
    """Times of a frame with its own camera, because the shared renderer keeps what depends on a camera."""
    view = views[seed % len(views)]
    return method.render(jittered_view(view, methods * seed + place), gaze, seed).milliseconds


def _view_keys(setting: Setting) -> tuple[bytes, ...]:
    """Identifies the views and the size of a row's frames."""
    return tuple(view.key for view in setting.seen)


def _advanced(
    progress: Callable[[int, int], None], before: int, rows: int, all_rows: int, done: int, total: int
) -> None:
    """Reports the progress of a group of rows as that of the sweep."""
    progress(1000 * before + 1000 * rows * done // total, 1000 * all_rows)


def _row(
    setting: Setting, ours: Frames, full: dict[tuple[int, bool], Frames], effort: Effort
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
        **_ranges(setting, total, same),
    }
    if setting.over_one_spp:
        row["ratio_1spp"] = ratio_of_medians(of_full[1, setting.is_denoised], total)
    return {**row, "paper": setting.paper} if setting.paper else row


def _ranges(setting: Setting, total: list[float], full: list[float]) -> dict[str, Any]:
    """Least and greatest medians of times, and ratio of medians, over the views; empty for a single view.

    Args:
        setting: of the row.
        total, full: milliseconds of hybrid and full frames, in pairs.
    """
    if len(setting.seen) < 2:
        return {}
    times, of_full = (medians_by_view(found, len(setting.seen)) for found in (total, full))
    ratios = [over / under for over, under in zip(of_full, times, strict=True)]
    return {"ms_range": [min(times), max(times)], "ratio_range": [min(ratios), max(ratios)]}
