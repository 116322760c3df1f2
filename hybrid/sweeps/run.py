"""Times, and where asked judges, every row of a sweep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.mode import FoveaMode
from hybrid.frame.renderer import Renderer
from hybrid.measure.quality import Viewer, measured
from hybrid.measure.reference import REFERENCE_SEED, Reference, reference
from hybrid.measure.regions import Region, plain_regions
from hybrid.measure.timing import interleaved_passes, jittered, percentiles
from hybrid.methods.hybrid import HybridMethod
from hybrid.methods.method import Method
from hybrid.methods.path_traced import FullTrace
from hybrid.store.journal import Journal
from hybrid.sweeps.break_even import ratio_interval
from hybrid.sweeps.coverage import covered, reach_for
from hybrid.sweeps.setting import Setting
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# What quality is told apart by.
_JUDGED = ("whole", "foveal", "peripheral")


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        repeats, warm_up: frames per row.
        reference_spp: samples per pixel of references.
    """

    repeats: int
    warm_up: int
    reference_spp: int


def swept(
    scene: Scene,
    forest: Forest,
    settings: list[Setting],
    judge: bool,
    effort: Effort,
    journal: Journal,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per setting: what was varied, `ms` of the hybrid and of the full frame, and their `ratio`.

    `ratio_1spp`, where a setting asks for it, is that to the full frame at one sample per pixel.

    Rows of one view and size take turns with the full path-traced frame at each of their sample counts,
    denoised where the fovea is. The gaze of all of them takes one path, on which the largest of their discs
    stays in the frame; `covered` is the mean share of the frame that a row's disc covers on it. Each frame
    has a camera of its own, far less than a pixel from the last: nothing in it was made for another.

    Args:
        scene, forest: what is rendered.
        settings: the rows.
        judge: whether to measure quality as well, with the gaze in the middle.
        effort: how much is measured.
        journal: keeps the rows of each view and size; what it holds already is not measured again.
        progress: called with how much is done and how much there is, in thousandths of a row.

    Raises:
        UserError: a region of a frame that is to be judged is empty; before anything is measured.
    """
    if judge:
        for setting in settings:
            _judged_regions(setting)
    renderer = Renderer(scene, forest)
    rows: list[dict[str, Any]] = []
    for number, (_, group) in enumerate(groupby(settings, key=lambda setting: setting.camera.key)):
        same = list(group)
        done = partial(_advanced, progress, len(rows), len(same), len(settings))
        rows += journal.once(str(number), partial(_group, renderer, same, judge, effort, done))
        done(1, 1)
    return rows


def _group(
    renderer: Renderer,
    same: list[Setting],
    judge: bool,
    effort: Effort,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """Rows of one camera, which take turns."""
    camera, tracer = same[0].camera, renderer.tracer
    ours = [HybridMethod(renderer, s.frame) for s in same]
    wanted = [(s.frame.spp, _is_denoised(s)) for s in same]
    wanted += [(1, _is_denoised(s)) for s in same if s.over_one_spp]
    full = {of: FullTrace(tracer, *of) for of in wanted}
    methods: list[Method] = [*ours, *full.values()]
    timed = [partial(_passes, method, camera, len(methods), place) for place, method in enumerate(methods)]
    reach = reach_for(max(s.frame.fov_a for s in same), camera)
    times = interleaved_passes(timed, effort.repeats, effort.warm_up, progress, reach)
    of_full = dict(zip(full, times[len(ours) :], strict=True))
    truth = reference(tracer, camera, effort.reference_spp, REFERENCE_SEED) if judge else None
    rows = []
    for setting, method, found in zip(same, ours, times, strict=False):
        row = _row(setting, found, of_full, effort)
        row["covered"] = covered(setting.frame.fov_a, camera, effort.repeats, reach)
        if truth is not None:
            row["quality"] = _quality(setting, method, truth)
        rows.append(row)
    return rows


def _advanced(
    progress: Callable[[int, int], None], before: int, rows: int, all_rows: int, done: int, total: int
) -> None:
    progress(1000 * before + 1000 * rows * done // total, 1000 * all_rows)


def _is_denoised(setting: Setting) -> bool:
    return setting.frame.fovea is not FoveaMode.RAW


def _passes(
    method: Method, camera: Camera, methods: int, place: int, gaze: Gaze, seed: int
) -> dict[str, float]:
    """Times of a frame whose camera no other frame has: the shared renderer keeps what a camera shows."""
    return method.render(jittered(camera, methods * seed + place), gaze, seed).milliseconds


def _row(
    setting: Setting,
    ours: list[dict[str, float]],
    full: dict[tuple[int, bool], list[dict[str, float]]],
    effort: Effort,
) -> dict[str, Any]:
    """Times of a setting, and of full frames by samples per pixel and whether they are denoised."""
    total = [frame["total"] for frame in ours]
    of_full = {of: [frame["total"] for frame in frames] for of, frames in full.items()}
    denoised = _is_denoised(setting)
    same = of_full[setting.frame.spp, denoised]
    row: dict[str, Any] = {
        **setting.varied,
        "ms": percentiles(total),
        "full_ms": percentiles(same),
        "ratio": float(np.median(same) / np.median(total)),
        "ratio_interval": ratio_interval(same, total),
        "passes": {n: float(np.median([f[n] for f in ours])) for n in ours[0] if n != "total"},
        "repeats": effort.repeats,
    }
    if setting.over_one_spp:
        row["ratio_1spp"] = float(np.median(of_full[1, denoised]) / np.median(total))
    return {**row, "paper": setting.paper} if setting.paper else row


def _judged_regions(setting: Setting) -> dict[str, Region]:
    size = setting.camera.height, setting.camera.width
    return plain_regions(replace(setting.frame, gaze=Gaze()).foveation, size, _JUDGED)


def _quality(setting: Setting, method: HybridMethod, truth: Reference) -> dict[str, float]:
    """Metrics by region and name, such as "foveal jod"."""
    image = method.render(setting.camera, Gaze(), 0).image
    viewer = Viewer(setting.frame.display, Gaze())
    rows = measured(image, truth.radiance, _judged_regions(setting), viewer)
    return {f"{row['region']} {row['metric']}": float(row["value"]) for row in rows}
