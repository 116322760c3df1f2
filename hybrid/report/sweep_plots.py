"""Plots of a sweep, as SVG elements."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hybrid.report.figure import (
    METRIC_LABELS,
    TIME_LABEL,
    add_legend_beside,
    add_point,
    new_axes,
    plain_ticks,
    svg_of,
)
from hybrid.sweeps.setting import varied

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Plotted over time, if all rows have it.
_QUALITY = ("whole jod", "foveal jod", "foveal flip")
# Sweeps over frame sizes, which are positions on the axis by themselves.
_OVER_SIZES = ("resolution", "aspect")
Row = dict[str, Any]


def sweep_plots(found: dict[str, Any]) -> list[str]:
    """The ratio to full path tracing over the varied quantity, and quality over time if it was measured."""
    rows = found["rows"]
    plots = [_ratio_plot(found["over"], rows, found["break_even"])]
    for metric in _QUALITY:
        if all(metric in row.get("quality", {}) for row in rows):
            plots.append(_quality_plot(rows, metric))
    return plots


def _ratio_plot(over: str, rows: list[Row], crossings: list[dict[str, Any]]) -> str:
    """A line per combination of all quantities but the last one, which is the horizontal axis.

    Foveated Path Culling's (FPC's) ratios are hollow points beside ours, or where it breaks even.
    """
    axes = new_axes()
    for name, line in _lines(over, rows).items():
        _plot_line(axes, over, name or "this project", line)
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


def _lines(over: str, rows: list[Row]) -> dict[str, list[Row]]:
    """Rows of each line by its name."""
    lines: dict[str, list[Row]] = {}
    for row in rows:
        before = [] if over in _OVER_SIZES else list(varied(row).items())[:-1]
        lines.setdefault(", ".join(f"{name} {_short(value)}" for name, value in before), []).append(row)
    return lines


def _plot_line(axes: Axes, over: str, name: str, line: list[Row]) -> None:
    """One line of ratios, and FPC's if there are any."""
    positions = [_position(over, row) for row in line]
    (drawn,) = axes.plot(positions, [row["ratio"] for row in line], "o-", ms=4, label=name)
    known = [
        (position, row["paper"]["ratio"])
        for position, row in zip(positions, line, strict=True)
        if "ratio" in row.get("paper", {})
    ]
    if known:
        axes.plot(*zip(*known, strict=True), "o--", mfc="none", color=drawn.get_color(), label="FPC")


def _quality_plot(rows: list[Row], metric: str) -> str:
    """Quality over time, one point per row; the metric is a region and a name."""
    axes = new_axes()
    for number, row in enumerate(rows, 1):
        name = ", ".join(_short(value) for value in varied(row).values())
        add_point(axes, number, row["ms"]["p50"], row["quality"][metric], name, ours=True)
    add_legend_beside(axes)
    axes.set_xlabel(TIME_LABEL)
    region, name = metric.split()
    axes.set_ylabel(f"{METRIC_LABELS[name]}, {region}")
    return svg_of(axes)


def _position(over: str, row: Row) -> Any:
    """Where a row lies on the horizontal axis."""
    if over in _OVER_SIZES:
        return f"{row['width']}x{row['height']}"
    value = list(varied(row).values())[-1]
    return value if isinstance(value, int | float) else str(value)


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
