"""Figures of a page as SVG, and what all of them share."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

# Colours of this project's points and lines, and of all others.
OURS_COLOUR, OTHER_COLOUR = "#c33", "#36c"
METRIC_LABELS = {
    "jod": "FovVideoVDP, JOD",
    "flip": "FLIP",
    "ssim": "SSIM",
    "psnr": "PSNR, dB",
    "lpips": "LPIPS",
}
TIME_LABEL = "median time of a frame, ms"


def new_axes() -> Axes:
    """The axes of a new figure."""
    # Not pyplot, which opens windows and has global state.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
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
