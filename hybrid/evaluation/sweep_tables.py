"""A sweep's rows as a table, and the radius at which hybrid and full frames take equally long."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from hybrid.evaluation import fpc
from hybrid.evaluation.sweep_catalogue import varied


def table(rows: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Cells of a sweep's rows by column name, without quality; columns that no row has are left out."""
    columns = {name: [short(row[name]) for row in rows] for name in varied(rows[0])}
    columns["covered, %"] = [f"{100 * row['covered']:.1f}" if "covered" in row else "-" for row in rows]
    columns["ms"] = [with_range(row["ms"]["p50"], row.get("ms_range"), ".0f") for row in rows]
    columns["full, ms"] = [f"{row['full_ms']['p50']:.0f}" for row in rows]
    papers = [row.get("paper", {}) for row in rows]
    for key, name in (("ratio", "ratio"), ("ratio_1spp", "ratio to 1 spp")):
        columns[name] = _ratios(rows, key)
        columns[f"FPC's {name}"] = _ratios(papers, key)
    return {name: cells for name, cells in columns.items() if set(cells) != {"-"}}


def with_range(value: float, between: Sequence[float] | None, format_spec: str, unit: str = "") -> str:
    """A mean or median over views with the least and the greatest value of a view, if there are several."""
    cell = format(value, format_spec) + unit
    return cell if between is None else f"{cell} ({'–'.join(format(end, format_spec) for end in between)})"


def quality_cells(rows: list[dict[str, Any]], name: str, format_spec: str) -> list[str]:
    """Cells of a metric of one region, such as "foveal jod"."""
    return [
        with_range(row["quality"][name], row.get("quality_range", {}).get(name), format_spec) for row in rows
    ]


def _ratios(rows: list[dict[str, Any]], name: str) -> list[str]:
    return [with_range(row[name], row.get(f"{name}_range"), ".2f") if name in row else "-" for row in rows]


def short(value: Any) -> str:
    """A varied quantity in a cell or a label."""
    return f"{value:g}" if isinstance(value, float) else str(value)


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
