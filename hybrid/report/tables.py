"""Tables of the page."""

from __future__ import annotations

from typing import Any

from hybrid.evaluation.keys import HALVES_KEY, OURS_KEY, Key
from hybrid.evaluation.results import budget_label, mean_of
from hybrid.measure.quality import METRICS
from hybrid.sweeps.table import quality_cells, table, with_range

_DIGITS = {"psnr": 2, "ssim": 4, "fssim": 4, "flip": 4, "hdr-flip": 4, "lpips": 4, "jod": 2}
_PERCENTILES = ("p50", "p95", "p99")


def quality_table(found: dict[str, Any], region: str, keys: list[Key]) -> dict[str, Any]:
    """Means over the views of one region: `region`, `metrics`, and `rows` of the methods and references.

    Args:
        found: the content of evaluation.json.
        region: name of the region.
        keys: of the methods.
    """
    metrics = [m for m in METRICS if mean_of(found, OURS_KEY, region, m) is not None]
    rows = []
    for key in [*keys, HALVES_KEY]:
        values = [mean_of(found, key, region, metric) for metric in metrics]
        cells = ["-" if v is None else f"{v:.{_DIGITS[m]}f}" for v, m in zip(values, metrics, strict=True)]
        rows.append(_row(key.method, budget_label(found, key), cells))
    return {"region": region, "metrics": metrics, "rows": rows}


def time_table(found: dict[str, Any]) -> dict[str, Any]:
    """Percentiles of frames, and medians of passes, in milliseconds: `columns`, and `rows` of the methods."""
    passes = list(dict.fromkeys(name for row in found["time"] for name in row["passes"]))
    compared = any("over_ours" in row for row in found["time"])
    rows = []
    for row in found["time"]:
        cells = [f"{row['ms'][p]:.0f}" if p in row["ms"] else "-" for p in _PERCENTILES]
        cells[0] = with_range(row["ms"]["p50"], row.get("ms_range"), ".0f")
        cells += [f"{row['over_ours']:.2f}" if "over_ours" in row else "-"] if compared else []
        cells += [f"{1000 / row['ms']['p50']:.1f}" if row["ms"]["p50"] > 0 else "-", str(row["repeats"])]
        cells += [f"{row['passes'][name]:.0f}" if name in row["passes"] else "-" for name in passes]
        rows.append(_row(row["method"], budget_label(found, Key(row["method"], row["budget"])), cells))
    return {
        "columns": [*_PERCENTILES, *(["/ ours"] if compared else []), "FPS", "frames", *passes],
        "rows": rows,
    }


def sweep_columns(rows: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Cells of a sweep by column name, quality included if it was measured."""
    columns = table(rows)
    for name in rows[0].get("quality", {}):
        digits = _DIGITS[name.split()[1]]
        columns[name] = quality_cells(rows, name, f".{digits}f")
    return columns


def _row(method: str, budget: str, cells: list[str]) -> dict[str, Any]:
    return {"method": method, "budget": budget, "cells": cells, "ours": method.startswith("hybrid")}
