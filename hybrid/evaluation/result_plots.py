"""Plots of an evaluation and of sweeps, as SVG elements."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any, NamedTuple

from hybrid.evaluation.measured_settings import pareto_front
from hybrid.evaluation.results import FIXED, METRIC_NAMES, OURS, Key, Results
from hybrid.evaluation.sweep_catalogue import short, varied
from hybrid.measure.frame_quality import METRICS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

Row = dict[str, Any]
# Colours of this project's points and lines, and of all others.
OURS_COLOUR, OTHER_COLOUR = "#c33", "#36c"
METRIC_LABELS = {**METRIC_NAMES, "jod": "FovVideoVDP, JOD", "psnr": "PSNR, dB"}
TIME_LABEL = "median time of a frame, ms"
# Plotted over time for a sweep, if all rows have it.
_QUALITY = ("whole jod", "foveal jod", "foveal flip")
# Sweeps over frame sizes, which are positions on the axis by themselves.
_OVER_SIZES = ("resolution", "aspect")


def new_axes(height: float = 4.2) -> Axes:
    """The axes of a new figure of that height in inches."""
    # Not pyplot, which opens windows and has global state.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, height), layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#ddd", lw=0.5)
    axes.set_axisbelow(True)
    return axes


def add_point(axes: Axes, number: int, x: float, y: float, name: str, ours: bool) -> None:
    """Adds a numbered point; its name goes to the legend, where names do not cover each other."""
    axes.scatter(x, y, s=24, color=OURS_COLOUR if ours else OTHER_COLOUR, zorder=2, label=f"{number}  {name}")
    axes.annotate(str(number), (x, y), xytext=(4, 3), textcoords="offset points", fontsize=7)


def add_legend_beside(axes: Axes) -> None:
    """Adds the legend to the right of the plot."""
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), frameon=False, fontsize=7, handletextpad=0.3)


def plain_ticks(axis: Axis) -> None:
    """Labels a logarithmic axis with 1, 2, 5, 10 and so on instead of powers."""
    from matplotlib.ticker import LogLocator, NullLocator, ScalarFormatter

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(ScalarFormatter())
    axis.set_minor_locator(NullLocator())


def svg_of(axes: Axes) -> str:
    """The figure of these axes as an SVG element."""
    buffer = io.StringIO()
    axes.get_figure().savefig(buffer, format="svg", metadata={"Date": None})  # type: ignore[union-attr]
    text = buffer.getvalue()
    return text[text.index("<svg") :]


class Point(NamedTuple):
    """A method at one budget: the median time of a frame, and the mean of a metric over the views."""

    key: Key
    milliseconds: float
    value: float


def points_of(results: Results, region: str, metric: str) -> list[Point]:
    """All methods and budgets of an evaluation that were timed and whose metric was measured."""
    means = {key: results.mean(key, region, metric) for key in results.keys if key in results.times}
    return [Point(key, results.times[key], mean) for key, mean in means.items() if mean is not None]


def pareto_optimal(points: list[Point], metric: str) -> list[Point]:
    """The Pareto front: no other point is both faster and better. From the fastest to the best."""
    sign = 1 if METRICS[metric] else -1
    return pareto_front(points, lambda point: (point.milliseconds, sign * point.value))


def quality_over_time_plot(results: Results, region: str, metric: str) -> str | None:
    """Quality of all methods over their times, with the Pareto front as a line; None if none has both."""
    points = points_of(results, region, metric)
    if not points:
        return None
    axes = new_axes()
    front = pareto_optimal(points, metric)
    axes.plot([p.milliseconds for p in front], [p.value for p in front], color="#888", lw=1, zorder=1)
    for number, point in enumerate(points, 1):
        ours = point.key.method.startswith("hybrid")
        add_point(axes, number, point.milliseconds, point.value, results.label(point.key), ours)
    add_legend_beside(axes)
    axes.set_xscale("log")
    plain_ticks(axes.xaxis)
    axes.set_xlabel(TIME_LABEL)
    axes.set_ylabel(f"{METRIC_LABELS[metric]}, {region}")
    return svg_of(axes)


def samples_plot(results: Results, metric: str) -> str | None:
    """Foveal quality of fused frames over samples per pixel; None if the metric was not always measured."""
    splats = results.mean(Key("splats alone", FIXED), "foveal", metric)
    by_spp = {spp: value for spp, value in results.fused_by_spp(metric).items() if value is not None}
    if splats is None or len(by_spp) < len(results.fused_by_spp(metric)):
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


def sweep_plots(found: dict[str, Any]) -> list[str]:
    """The ratio to full path tracing over the varied quantity, and quality over time if it was measured."""
    rows = found["rows"]
    known = [metric for metric in _QUALITY if all(metric in row.get("quality", {}) for row in rows)]
    ratios = _ratio_plot(found["over"], rows, found["break_even"])
    return [ratios, *(_quality_plot(rows, metric) for metric in known)]


def _ratio_plot(over: str, rows: list[Row], crossings: list[dict[str, Any]]) -> str:
    """A line per combination of all quantities but the last one, which is the horizontal axis.

    Foveated Path Culling's (FPC's) ratios are hollow points beside ours, or where it breaks even.
    """
    lines: dict[str, list[Row]] = {}
    for row in rows:
        before = [] if over in _OVER_SIZES else list(varied(row).items())[:-1]
        lines.setdefault(", ".join(f"{name} {short(value)}" for name, value in before), []).append(row)
    axes = new_axes()
    for name, line in lines.items():
        positions, ratios = [_position(over, row) for row in line], [row["ratio"] for row in line]
        (drawn,) = axes.plot(positions, ratios, "o-", ms=4, label=name or "this project")
        papers = [row.get("paper", {}).get("ratio") for row in line]
        known = [(x, ratio) for x, ratio in zip(positions, papers, strict=True) if ratio is not None]
        if known:
            axes.plot(*zip(*known, strict=True), "o--", mfc="none", color=drawn.get_color(), label="FPC")
    colours = [line.get_color() for line in axes.lines]
    for crossing, colour in zip(crossings, colours, strict=False):
        axes.plot(crossing["paper"], 1, "o", mfc="none", color=colour)
    axes.axhline(1, color="#888", lw=0.8)
    axes.set_yscale("log")
    plain_ticks(axes.yaxis)
    axes.set_xlabel("frame size" if over in _OVER_SIZES else list(varied(rows[0]))[-1])
    axes.set_ylabel("times faster than full path tracing")
    axes.legend(frameon=False, fontsize=7)
    return svg_of(axes)


def _quality_plot(rows: list[Row], metric: str) -> str:
    """Quality over time, one point per row; the metric is a region and a name."""
    axes = new_axes()
    for number, row in enumerate(rows, 1):
        name = ", ".join(short(value) for value in varied(row).values())
        add_point(axes, number, row["ms"]["p50"], row["quality"][metric], name, ours=True)
    add_legend_beside(axes)
    axes.set_xlabel(TIME_LABEL)
    region, name = metric.split()
    axes.set_ylabel(f"{METRIC_LABELS[name]}, {region}")
    return svg_of(axes)


def _position(over: str, row: Row) -> float | str:
    if over in _OVER_SIZES:
        return f"{row['width']}x{row['height']}"
    value = list(varied(row).values())[-1]
    return value if isinstance(value, int | float) else str(value)
