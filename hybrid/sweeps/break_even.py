"""The radius of the disc at which a hybrid frame takes as long as the full path-traced one."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from hybrid.sweeps import fpc


def break_even(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Where hybrid and full path-traced frames take equally long, for each resolution of a radius sweep.

    `radius` is where the ratio of medians falls below 1, `slower_from` where its whole confidence interval
    does: a disc that covers nearly all of the frame takes nearly as long as the full frame, so that the two
    differ by less than can be measured. Both are None if that happens at no measured radius.
    """
    found = []
    for size in dict.fromkeys((row["width"], row["height"]) for row in rows):
        same = [row for row in rows if (row["width"], row["height"]) == size]
        radii = [row["radius"] for row in same]
        found.append(
            {
                "width": size[0],
                "height": size[1],
                "radius": _crossing(radii, [row["ratio"] for row in same]),
                "slower_from": _crossing(radii, [row["ratio_interval"][1] for row in same]),
                "least_ratio": min(row["ratio"] for row in same),
                "paper": fpc.BREAK_EVEN.get(size),
            }
        )
    return found


def sentence(row: dict[str, Any]) -> str:
    """A row of `break_even` in words."""
    radius = "more than 90" if row["radius"] is None else f"{row['radius']:.0f}"
    slower = "at no radius" if row["slower_from"] is None else f"from {row['slower_from']:.0f} % on"
    return (
        f"{row['width']}x{row['height']}: as fast as full path tracing at a radius of {radius} % of the "
        f"height (FPC: {row['paper']:.0f}), slower with 95 % confidence {slower}; "
        f"lowest ratio {row['least_ratio']:.3f}."
    )


def _crossing(radii: list[float], ratios: list[float]) -> float | None:
    """Where ratios first fall below 1, interpolated linearly between radii."""
    if ratios[0] < 1:
        return radii[0]
    for (before, ratio), (after, after_ratio) in pairwise(zip(radii, ratios, strict=True)):
        if ratio >= 1 > after_ratio:
            return before + (ratio - 1) / (ratio - after_ratio) * (after - before)
    return None
