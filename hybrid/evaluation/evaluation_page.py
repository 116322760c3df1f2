"""The page of an evaluation: one file that requires no server."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader
from markupsafe import Markup
from PIL import Image as PillowImage

from compose.base.errors import UserError, one_line
from compose.base.files import json_text, read_json, write_text
from hybrid.evaluation.evaluation_settings import FOVEAL_REFERENCE
from hybrid.evaluation.result_plots import quality_over_time_plot, samples_plot, sweep_plots
from hybrid.evaluation.results import (
    OURS_KEY,
    TOLERANCE,
    WHOLE_METRIC,
    Key,
    Results,
    flip_name,
    image_name,
)
from hybrid.evaluation.sweep_catalogue import sentence, table, with_range
from hybrid.evaluation.verdicts import sentences
from hybrid.measure.frame_quality import METRICS, missing
from hybrid.measure.image_metrics import REGIONS

# How metrics are shown.
FORMS = {metric: ".2f" if metric in ("psnr", "jod") else ".4f" for metric in METRICS}
_PERCENTILES = ("p50", "p95", "p99")
# Images in the page are compressed; the PNG files beside it are not.
_JPEG_QUALITY = 90
# What the page shows of evaluation.json.
_CONTENT = (
    *("scene", "settings", "display", "views", "references"),
    *("methods", "quality", "time", "preparation", "machine"),
)


def write_evaluation(folder: Path, found: dict[str, Any]) -> None:
    """Writes evaluation.json and the page of an evaluation."""
    write_text(folder / "evaluation.json", json_text(found))
    write_report(folder)


def write_report(folder: Path) -> None:
    """Writes index.html from evaluation.json, the images, and the sweeps in the same folder."""
    results = Results(_read(folder / "evaluation.json"))
    sweeps = [_read(file) for file in sorted(folder.glob("sweep-*.json"))]
    metrics = results.foveal_metrics
    over_time = [quality_over_time_plot(results, "foveal", metric) for metric in metrics]
    over_time.append(quality_over_time_plot(results, "whole", WHOLE_METRIC))
    text = rendered(
        "evaluation.html",
        **_overview(results),
        over_time=_markup(over_time),
        samples=_markup([samples_plot(results, metric) for metric in metrics]),
        quality=[quality_table(results, region) for region in REGIONS],
        time=time_table(results),
        preparation=results.found["preparation"],
        **_viewer(results, folder),
        sweeps=[_sweep(sweep) for sweep in sweeps],
    )
    write_text(folder / "index.html", text)


def rendered(template: str, room: str = "hybrid.evaluation", **values: object) -> str:
    """A page from a template of a room; values are escaped."""
    found = ChoiceLoader([PackageLoader(one, ".") for one in (room, "hybrid.evaluation")])
    return Environment(loader=found, autoescape=True).get_template(template).render(**values)


def evaluated_scene(folder: Path) -> str:
    """Name of the scene of the evaluation in a folder; UserError if there is none, or a damaged one."""
    file = folder / "evaluation.json"
    try:
        found = read_json(file, finite=False)
        lacks = [name for name in _CONTENT if name not in found]
        if lacks:
            raise ValueError(f"no {lacks[0]}")
        return str(found["scene"])
    except FileNotFoundError:
        raise UserError(f"{folder}: holds no evaluation; make one with hybrid evaluate first") from None
    except (OSError, ValueError, TypeError) as error:
        raise UserError(f"{file}: is damaged ({error}); run hybrid evaluate again") from error


def _read(file: Path) -> dict[str, Any]:
    try:
        return dict(read_json(file, finite=False))
    except (OSError, ValueError, TypeError) as error:
        raise UserError(f"{file}: is damaged ({one_line(error)}); delete it and make it again") from error


def _overview(results: Results) -> dict[str, Any]:
    found = results.found
    settings, machine = found["settings"], found["machine"]
    packages = ", ".join(f"{name} {version}" for name, version in machine["packages"].items())
    psnr = {n: [r["psnr"] for r in found["references"] if r["region"] == n] for n in ("whole", "foveal")}
    return {
        "title": f"Evaluation of {found['scene']}",
        "subtitle": (
            f"{settings['width']} × {settings['height']}, samples per pixel in the disc: {settings['spp']}, "
            f"fov-a {settings['fov_a']:g} %, fov-b {settings['fov_b']:g} % of the height, "
            f"{len(found['views'])} views, seeds per view: {settings['seeds']}. References: "
            f"{settings['reference_spp']} samples per pixel, "
            f"{FOVEAL_REFERENCE * settings['reference_spp']} in the disc"
            f"{', denoised' if settings['denoised_references'] else ''}."
        ),
        "verdicts": sentences(found),
        "settings": settings,
        # Evaluations of earlier versions have none.
        "plan": found.get("plan", {}),
        "reference_note": (
            f"Against the truth, the references have {min(psnr['whole']):.1f} to {max(psnr['whole']):.1f} dB "
            f"over the whole frame and {min(psnr['foveal']):.1f} to {max(psnr['foveal']):.1f} dB in the "
            "fovea, denoising bias included."
        ),
        "tolerance": f"{100 * TOLERANCE:g}",
        "machine": f"{machine['cpu']}, {machine['cores']} cores, Python {machine['python']}, {packages}",
        "missing": missing(),
    }


def quality_table(results: Results, region: str) -> dict[str, Any]:
    """Means over the views of one region: `region`, `columns`, and `rows` of the methods."""
    metrics = [m for m in METRICS if results.mean(OURS_KEY, region, m) is not None]
    rows = []
    for key in results.keys:
        values = [results.mean(key, region, metric) for metric in metrics]
        cells = ["-" if v is None else format(v, FORMS[m]) for v, m in zip(values, metrics, strict=True)]
        rows.append(_row(results, key, cells))
    return {"region": region, "columns": metrics, "rows": rows}


def time_table(results: Results) -> dict[str, Any]:
    """Percentiles of frames, and medians of passes, in milliseconds: `columns`, and `rows` of the methods."""
    times = results.found["time"]
    passes = list(dict.fromkeys(name for row in times for name in row["passes"]))
    rows = []
    for row in times:
        cells = [f"{row['ms'][p]:.0f}" if p in row["ms"] else "-" for p in _PERCENTILES]
        cells[0] = with_range(row["ms"]["p50"], row.get("ms_range"), ".0f")
        cells += [with_range(row["over_ours"], row["over_ours_range"], ".2f")]
        cells += [f"{1000 / row['ms']['p50']:.1f}" if row["ms"]["p50"] > 0 else "-", str(row["repeats"])]
        cells += [f"{row['passes'][name]:.0f}" if name in row["passes"] else "-" for name in passes]
        rows.append(_row(results, Key.of(row), cells))
    columns = [*_PERCENTILES, "/ ours", "FPS", "frames", *passes]
    return {"columns": columns, "rows": rows}


def _row(results: Results, key: Key, cells: list[str]) -> dict[str, Any]:
    ours = key.method.startswith("hybrid")
    return {"method": key.method, "budget": results.budget_label(key), "cells": cells, "ours": ours}


def _viewer(results: Results, folder: Path) -> dict[str, Any]:
    labels = {key: results.label(key) for key in results.keys}
    views = [row for row in results.found["views"] if (folder / image_name(row["view"], None)).exists()]
    return {
        "views": [f"{row['view'] + 1}, {row['kind']}" for row in views],
        "images": [embedded_images(folder, row["view"], labels) for row in views],
        "flips": [embedded_flips(folder, row["view"], labels) for row in views],
        "left": OURS_KEY.label,
        "right": "reference",
    }


def embedded_images(folder: Path, view: int, labels: dict[Key, str]) -> dict[str, str]:
    """Data URLs of a view's frames by their labels, the reference first."""
    files = {"reference": folder / image_name(view, None)}
    # At equal time, a baseline may have no frame of a view.
    files |= {label: folder / image_name(view, key) for key, label in labels.items()}
    return {label: _data_url(file) for label, file in files.items() if file.exists()}


def embedded_flips(folder: Path, view: int, labels: dict[Key, str]) -> dict[str, str]:
    """Data URLs of a view's FLIP maps by their labels, as far as there are any."""
    files = {label: folder / flip_name(view, key) for key, label in labels.items()}
    return {label: _data_url(file) for label, file in files.items() if file.exists()}


def _data_url(file: Path) -> str:
    buffer = io.BytesIO()
    PillowImage.open(file).convert("RGB").save(buffer, format="JPEG", quality=_JPEG_QUALITY, subsampling=0)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()


def _sweep(sweep: dict[str, Any]) -> dict[str, Any]:
    rows, count = sweep["rows"], sweep.get("views", 1)
    columns = table(rows, FORMS)
    fovea = "" if "fovea" in columns else f", {sweep['fovea']} fovea"
    note = (
        f"Frames of {count} views that nothing was fitted to: times are medians of all their frames, quality "
        "is the mean over the views; in brackets the least and the greatest value of a view."
    )
    if count == 1:
        # Files of earlier versions do not say what their figures are of.
        note = "Each row is of a single view." if "views" in sweep else ""
    return {
        "title": f"{sweep['scene']}, over {sweep['title']}{fovea}, {rows[0]['repeats']} frames each",
        "views": note,
        "plots": _markup(sweep_plots(sweep)),
        "columns": list(columns),
        "rows": list(zip(*columns.values(), strict=True)),
        "sentences": [sentence(row) for row in sweep["break_even"]],
    }


def _markup(plots: Sequence[str | None]) -> list[Markup]:
    """SVG elements that jinja does not escape, without those that could not be plotted."""
    return [Markup(plot) for plot in plots if plot is not None]
