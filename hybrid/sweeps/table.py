"""A sweep's rows as a table: varied quantities, coverage, times and ratios."""

from __future__ import annotations

from typing import Any

from hybrid.sweeps.setting import varied


def table(rows: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Cells by column name, without quality; columns of ratios that no row has are left out.

    Args:
        rows: of one sweep.
    """
    columns = {name: [_short(row[name]) for row in rows] for name in varied(rows[0])}
    columns["covered, %"] = [_number(100 * row["covered"], 1) if "covered" in row else "-" for row in rows]
    columns["ms"] = [_number(row["ms"]["p50"], 0) for row in rows]
    columns["full, ms"] = [_number(row["full_ms"]["p50"], 0) for row in rows]
    papers = [row.get("paper", {}) for row in rows]
    for key, name in (("ratio", "ratio"), ("ratio_1spp", "ratio to 1 spp")):
        columns[name] = _ratios(rows, key)
        columns[f"FPC's {name}"] = _ratios(papers, key)
    return {name: cells for name, cells in columns.items() if set(cells) != {"-"}}


def _ratios(rows: list[dict[str, Any]], name: str) -> list[str]:
    return [_number(row[name], 2) if name in row else "-" for row in rows]


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}"


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
