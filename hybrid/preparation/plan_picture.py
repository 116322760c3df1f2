"""A picture of what a scene was planned by."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.files import write_whole
from compose.base.traced_samples import DIFFUSE
from compose.image.colour import srgb_from_radiance
from hybrid.preparation.decisions import DEPTH
from hybrid.preparation.gaussian_count import GAUSSIANS
from hybrid.preparation.scene_look import Look
from hybrid.preparation.scene_plan import ScenePlan

_TURNING = (0.9, 0.2, 0.1)
_SHARE = 0.7


def write_picture(path: Path, plan: ScenePlan, look: Look) -> None:
    """Writes a PNG: what the scene looks like, where its radiance turns, what Gaussians bring, its depths.

    Raises:
        UserError: the file cannot be written.
    """
    # Not pyplot, which opens windows and has global state.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7), layout="constrained")
    grid = figure.add_gridspec(2, 3)
    shown, turning, numbers = (figure.add_subplot(grid[0, column]) for column in range(3))
    depths, decisions = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1:])
    frame = srgb_from_radiance(look.denoised[0])
    _image(shown, frame, f"{plan.scene_name}, one of {len(look.views)} views")
    view = srgb_from_radiance(look.radiance[0])
    turns = ((look.gloss[0] != DIFFUSE) | look.reflected[0])[..., None]
    marked = np.where(turns, (1 - _SHARE) * view + _SHARE * np.array(_TURNING), view)
    _image(turning, marked, "radiance turns with the view (red)")
    _plot_gaussians(numbers, plan)
    _plot_depths(depths, plan)
    rows = [(row["name"], str(row["value"]), str(row["fixed"])) for row in plan.rows()]
    decisions.axis("off")
    table = decisions.table(rows, colLabels=("", "planned", "else"), loc="center", cellLoc="left")
    table.scale(1.3, 1.4)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_whole(path, lambda part: part.write_bytes(buffer.getvalue()))


def _image(axes: Any, image: Any, title: str) -> None:
    axes.imshow(np.clip(image, 0, 1), interpolation="nearest")
    axes.set_title(title, fontsize=9)
    axes.axis("off")


def _plot_gaussians(axes: Any, plan: ScenePlan) -> None:
    """What numbers of Gaussians leave, each in one colour, and the number that is planned."""
    decision = plan.decision(GAUSSIANS)
    curve = decision.evidence["error_db"]
    axes.semilogx([int(count) for count in curve], list(curve.values()), "o-", color="#36c")
    axes.axvline(float(decision.value), color="#c33")
    axes.set_xlabel("Gaussians", fontsize=8)
    axes.set_title("dB of as many plain ones; planned (red)", fontsize=9)


def _plot_depths(axes: Any, plan: ScenePlan) -> None:
    """Share of the radiance by the segments of paths, and where they are cut, if that was measured."""
    evidence = plan.decision(DEPTH).evidence
    if "needed" not in evidence:
        axes.axis("off")
        return
    depth, shares = evidence["needed"], evidence["share_by_depth"]
    axes.bar(range(1, len(shares) + 1), np.maximum(shares, 1e-6), color="#36c")
    axes.axvline(depth + 0.5, color="#c33")
    axes.set_yscale("log")
    axes.set_xlabel("segments", fontsize=8)
    axes.set_title(f"share of radiance; {evidence['beyond']:.2%} lies beyond {depth}", fontsize=9)
