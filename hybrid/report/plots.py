"""Plots of an evaluation, as SVG elements."""

from __future__ import annotations

from typing import Any

from hybrid.evaluation.keys import FIXED, OURS, Key
from hybrid.evaluation.results import fused_by_spp, label_of, mean_of
from hybrid.report.figure import (
    METRIC_LABELS,
    OTHER_COLOUR,
    OURS_COLOUR,
    TIME_LABEL,
    add_legend_beside,
    add_point,
    new_axes,
    plain_ticks,
    svg_of,
)
from hybrid.report.pareto_points import pareto_optimal, points_of


def quality_over_time_plot(found: dict[str, Any], region: str, metric: str) -> str | None:
    """Quality of all methods over their times, with the Pareto front as a line.

    Returns:
        None if no method has both.
    """
    points = points_of(found, region, metric)
    if not points:
        return None
    axes = new_axes()
    front = pareto_optimal(points, metric)
    axes.plot([p.milliseconds for p in front], [p.value for p in front], color="#888", lw=1, zorder=1)
    for number, point in enumerate(points, 1):
        ours = point.key.method.startswith("hybrid")
        add_point(axes, number, point.milliseconds, point.value, label_of(found, point.key), ours)
    add_legend_beside(axes)
    axes.set_xscale("log")
    plain_ticks(axes.xaxis)
    axes.set_xlabel(TIME_LABEL)
    axes.set_ylabel(f"{METRIC_LABELS[metric]}, {region}")
    return svg_of(axes)


def samples_plot(found: dict[str, Any], metric: str) -> str | None:
    """Foveal quality of fused frames over samples per pixel, with that of the splats as a line.

    Returns:
        None if the metric was not measured for all of them.
    """
    splats = mean_of(found, Key("splats alone", FIXED), "foveal", metric)
    by_spp = {spp: value for spp, value in fused_by_spp(found, metric).items() if value is not None}
    if splats is None or len(by_spp) < len(fused_by_spp(found, metric)):
        return None
    axes = new_axes()
    counts = sorted(by_spp)
    axes.plot(counts, [by_spp[n] for n in counts], "o-", color=OURS_COLOUR, label=OURS)
    axes.axhline(splats, color=OTHER_COLOUR, ls="--", label="splats alone")
    axes.set_xscale("log", base=2)
    axes.set_xticks(counts, [str(n) for n in counts])
    axes.set_xlabel("samples per pixel in the disc")
    axes.set_ylabel(f"{METRIC_LABELS[metric]}, foveal")
    axes.legend(frameon=False)
    return svg_of(axes)
