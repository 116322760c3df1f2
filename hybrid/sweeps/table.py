"""A sweep's rows as a table: varied quantities, coverage, times and ratios."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hybrid.sweeps.setting import varied


def table(rows: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Cells by column name, without quality; columns of ratios that no row has are left out.

    Args:
        rows: of one sweep.
    """
    columns = {name: [_short(row[name]) for row in rows] for name in varied(rows[0])}
    columns["covered, %"] = [_number(100 * row["covered"], 1) if "covered" in row else "-" for row in rows]
    columns["ms"] = [with_range(row["ms"]["p50"], row.get("ms_range"), ".0f") for row in rows]
    columns["full, ms"] = [_number(row["full_ms"]["p50"], 0) for row in rows]
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


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}"


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
