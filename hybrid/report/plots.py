"""Plots of an evaluation, as SVG."""

from __future__ import annotations

import io
from typing import Any

from hybrid.evaluation.entries import OURS
from hybrid.evaluation.verdicts import fused_by_spp, mean_of
from hybrid.report.trade_points import frontier, points_of
from hybrid.sweeps.setting import varied

_LABELS = {"jod": "FovVideoVDP, JOD", "flip": "FLIP", "ssim": "SSIM", "psnr": "PSNR, dB", "lpips": "LPIPS"}


def trade_plot(found: dict[str, Any], region: str, metric: str) -> str | None:
    """Time of a frame against its quality, all methods, with those that none other beats in both joined."""
    points = points_of(found, region, metric)
    if not points:
        return None
    figure, axes = _figure()
    best = frontier(points, metric)
    axes.plot([p.milliseconds for p in best], [p.value for p in best], color="#888", lw=1, zorder=1)
    for number, point in enumerate(points, 1):
        name = point.method if point.budget == "fixed" else f"{point.method} ({point.budget})"
        _point(axes, number, point.milliseconds, point.value, name, point.method.startswith("hybrid"))
    _named_beside(axes)
    _logarithmic_time(axes)
    axes.set_ylabel(f"{_LABELS[metric]}, {region}")
    return _svg(figure)


def samples_plot(found: dict[str, Any], metric: str) -> str | None:
    """Foveal quality over samples per pixel of the fused frame, with the splats' as a line."""
    splats = mean_of(found, ("splats alone", "fixed"), "foveal", metric)
    by_spp = fused_by_spp(found, metric)
    if splats is None or any(value is None for value in by_spp.values()):
        return None
    figure, axes = _figure()
    counts = sorted(by_spp)
    axes.plot(counts, [by_spp[n] for n in counts], "o-", color="#c33", label=OURS)
    axes.axhline(splats, color="#36c", ls="--", label="splats alone")
    axes.set_xscale("log", base=2)
    axes.set_xticks(counts, [str(n) for n in counts])
    axes.set_xlabel("samples per pixel in the disc")
    axes.set_ylabel(f"{_LABELS[metric]}, foveal")
    axes.legend(frameon=False)
    return _svg(figure)


def sweep_plots(found: dict[str, Any]) -> list[str]:
    """Of a sweep: the ratio to full path tracing over what varies, and quality over time if it was judged."""
    rows = found["rows"]
    plots = [_ratio_plot(found["over"], rows, found["break_even"])]
    for metric in ("whole jod", "foveal jod", "foveal flip"):
        if all(metric in row.get("quality", {}) for row in rows):
            plots.append(_quality_plot(rows, metric))
    return plots


def _ratio_plot(over: str, rows: list[dict[str, Any]], crossings: list[dict[str, Any]]) -> str:
    """A line for each combination of all quantities but the last; FPC's figures hollow beside ours, or where
    it broke even."""
    figure, axes = _figure()
    lines: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        quantities = list(varied(row).items())
        before = quantities[:-1] if over not in ("resolution", "aspect") else []
        lines.setdefault(", ".join(f"{name} {_short(value)}" for name, value in before), []).append(row)
    for name, line in lines.items():
        places = [_place(over, row) for row in line]
        (drawn,) = axes.plot(places, [row["ratio"] for row in line], "o-", ms=4, label=name or "this project")
        known = [
            (p, r["paper"]["ratio"])
            for p, r in zip(places, line, strict=True)
            if "ratio" in r.get("paper", {})
        ]
        if known:
            axes.plot(*zip(*known, strict=True), "o--", mfc="none", color=drawn.get_color(), label="FPC")
    colours = [line.get_color() for line in axes.lines]
    for crossing, colour in zip(crossings, colours, strict=False):
        axes.plot(crossing["paper"], 1, "o", mfc="none", color=colour)
    axes.axhline(1, color="#888", lw=0.8)
    axes.set_yscale("log")
    _plain_ticks(axes.yaxis)
    axes.set_xlabel(list(varied(rows[0]))[-1] if over not in ("resolution", "aspect") else "frame size")
    axes.set_ylabel("times faster than full path tracing")
    axes.legend(frameon=False, fontsize=7)
    return _svg(figure)


def _quality_plot(rows: list[dict[str, Any]], metric: str) -> str:
    figure, axes = _figure()
    for number, row in enumerate(rows, 1):
        name = ", ".join(_short(value) for value in varied(row).values())
        _point(axes, number, row["ms"]["p50"], row["quality"][metric], name, ours=True)
    _named_beside(axes)
    axes.set_xlabel("median time of a frame, ms")
    axes.set_ylabel(f"{_LABELS[metric.split()[1]]}, {metric.split()[0]}")
    return _svg(figure)


def _place(over: str, row: dict[str, Any]) -> Any:
    if over in ("resolution", "aspect"):
        return f"{row['width']}x{row['height']}"
    value = list(varied(row).values())[-1]
    return value if isinstance(value, int | float) else str(value)


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _point(axes: Any, number: int, x: float, y: float, name: str, ours: bool) -> None:
    """A numbered point; its name stands beside the plot, where names do not cover each other."""
    axes.scatter(x, y, s=24, color="#c33" if ours else "#36c", zorder=2, label=f"{number}  {name}")
    axes.annotate(str(number), (x, y), xytext=(4, 3), textcoords="offset points", fontsize=7)


def _logarithmic_time(axes: Any) -> None:
    axes.set_xscale("log")
    _plain_ticks(axes.xaxis)
    axes.set_xlabel("median time of a frame, ms")


def _plain_ticks(axis: Any) -> None:
    """Of a logarithmic axis: 1, 2, 5, 10, not powers."""
    from matplotlib.ticker import LogLocator, NullLocator, ScalarFormatter

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(ScalarFormatter())
    axis.set_minor_locator(NullLocator())


def _named_beside(axes: Any) -> None:
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), frameon=False, fontsize=7, handletextpad=0.3)


def _figure() -> tuple[Any, Any]:
    # Not pyplot: no window, no state.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#ddd", lw=0.5)
    axes.set_axisbelow(True)
    return figure, axes


def _svg(figure: Any) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
