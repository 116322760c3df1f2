"""Runs a sweep from its name to its table; resumes if interrupted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hybrid.runtime.machine import machine
from hybrid.store.cache import scene_folder
from hybrid.store.identity import short_hash
from hybrid.store.journal import Journal
from hybrid.sweeps.break_even import break_even
from hybrid.sweeps.catalogue import sweep_named
from hybrid.sweeps.effort import Effort
from hybrid.sweeps.record import applied, identity_of
from hybrid.sweeps.run import swept
from hybrid.sweeps.setting import Setting
from hybrid.trade.measured import MeasuredSettings, MeasuredStore
from pathtrace.dataset.views import unseen_views
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Number of views that the sweep over views has, and in how many the rows of the others are measured.
_VIEWS, _JUDGED = 4, 3
# Metrics in which target qualities may be given; the first one that was measured is used.
_TARGET_METRICS = ("jod", "ssim")


def sweep(
    scene: Scene,
    forest: Forest,
    over: str,
    base: Setting,
    effort: Effort,
    write: Callable[[dict[str, Any]], None],
    progress: Callable[[int, int], None],
) -> dict[str, Any]:
    """Times hybrid frames and full path tracing in turns, over one quantity.

    Frames are timed, and their quality is measured, in three views that nothing was fitted to; the scene's
    own view is one of those that splats are trained on. A row of the sweep over views is one such view.

    Args:
        scene, forest: what is rendered.
        over: name of the sweep.
        base: the setting that it varies.
        effort: how much is measured.
        write: called with the result before the intermediate results are deleted.
        progress: called with work done and work in total, in thousandths of a row.

    Returns:
        scene, forest, over, title, views (in how many each row was measured), rows, break_even (of the sweep
        over the radius), the settings that all rows have in common, and machine.

    Raises:
        UserError: there is no such sweep, or a region whose quality is measured is empty.
    """
    chosen = sweep_named(over, forest.counts)
    views = unseen_views(scene, _VIEWS, base.camera.width, base.camera.height)
    settings = chosen.settings(base, views)
    if not chosen.over_views:
        settings = [setting.from_views(views[:_JUDGED]) for setting in settings]
    identity = identity_of(scene, forest, chosen, settings, effort)
    folder = scene_folder(scene.name, scene.hash)
    journal = Journal(folder / f"sweep-{over}-{short_hash(identity)}.json", identity)
    rows = swept(scene, forest, settings, chosen.with_quality, effort, journal, progress)
    if over == "trade":
        _store(scene, forest, settings, rows)
    content = {
        "scene": scene.name,
        "forest": forest.digest(),
        "over": over,
        "title": chosen.title,
        "views": len(settings[0].seen),
        "rows": rows,
        "break_even": break_even(rows) if over == "radius" else [],
        **applied(chosen, base, effort),
        "machine": machine(),
    }
    write(content)
    journal.remove()
    return content


def _store(scene: Scene, forest: Forest, settings: list[Setting], rows: list[dict[str, Any]]) -> None:
    """Stores the settings that target times and target qualities choose from."""
    metric = next(name for name in _TARGET_METRICS if f"whole {name}" in rows[0]["quality"])
    name = f"whole {metric}"
    measured = [
        MeasuredSettings(
            setting.frame, row["ms"]["p50"], row["quality"][name], tuple(row["quality_range"][name])
        )
        for setting, row in zip(settings, rows, strict=True)
    ]
    camera, frame = settings[0].camera, replace(settings[0].frame, camera=None)
    MeasuredStore.of("trade", scene, forest, (camera.width, camera.height), frame).save(metric, measured)
