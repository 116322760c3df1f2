"""The page of an evaluation: one file that needs no server."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup
from PIL import Image as PillowImage

from compose.base.errors import UserError
from compose.base.files import write_whole
from hybrid.evaluation.entries import OURS
from hybrid.evaluation.judged import HALVES, flip_name, picture_name
from hybrid.evaluation.settings import FOVEAL_REFERENCE
from hybrid.evaluation.verdicts import Key, foveal_metrics, keys_of, mean_of, verdicts
from hybrid.measure.metrics.installed import missing
from hybrid.measure.quality import METRICS
from hybrid.measure.regions import REGIONS
from hybrid.report.plots import samples_plot, sweep_plots, trade_plot
from hybrid.sweeps.break_even import sentence
from hybrid.sweeps.table import table

# What the page shows of evaluation.json.
_CONTENT = ("scene", "settings", "references", "methods", "quality", "time", "machine")
# Pictures in the page are compressed; the PNG files beside it are not.
_JPEG_QUALITY = 90
_DIGITS = {"psnr": 2, "ssim": 4, "fssim": 4, "flip": 4, "hdr-flip": 4, "lpips": 4, "jod": 2}


def write_report(folder: Path) -> None:
    """Writes index.html from evaluation.json, the pictures, and the sweeps that lie beside it.

    Args:
        folder: of the report.
    """
    found = json.loads((folder / "evaluation.json").read_text())
    sweeps = [json.loads(file.read_text()) for file in sorted(folder.glob("sweep-*.json"))]
    settings, machine = found["settings"], found["machine"]
    views = sorted({row["view"] for row in found["quality"]})
    keys, judged_by = keys_of(found), foveal_metrics(found)
    width, height = settings["width"], settings["height"]
    psnr = {n: [r["psnr"] for r in found["references"] if r["region"] == n] for n in ("whole", "foveal")}
    templates = Environment(loader=PackageLoader("hybrid.report", "."), autoescape=True)
    text = templates.get_template("evaluation.html").render(
        title=f"Evaluation of {found['scene']}",
        subtitle=(
            f"{width} × {height}, samples per pixel in the disc: {settings['spp']}, "
            f"fov-a {settings['fov_a']:g} %, fov-b {settings['fov_b']:g} % of the height, "
            f"{len(views)} views. References of {settings['reference_spp']} samples per pixel, "
            f"{FOVEAL_REFERENCE * settings['reference_spp']} in the disc, denoised."
        ),
        verdicts=verdicts(found),
        views=views,
        aspect=100 * width / height,
        gaze_x=100 * settings["gaze_x"] * width / height,
        gaze_y=100 * settings["gaze_y"],
        fov_a=settings["fov_a"],
        fov_b=settings["fov_b"],
        trade=_plots(
            [trade_plot(found, "foveal", m) for m in judged_by] + [trade_plot(found, "whole", "ssim")]
        ),
        sweeps=[_sweep(sweep) for sweep in sweeps],
        samples=_plots([samples_plot(found, metric) for metric in judged_by]),
        reference_note=(
            f"Against the truth the references have {min(psnr['whole']):.1f} to {max(psnr['whole']):.1f} dB, "
            f"{min(psnr['foveal']):.1f} to {max(psnr['foveal']):.1f} dB in the fovea, "
            "their denoiser's bias included."
        ),
        quality=[_quality_table(found, region, keys) for region in REGIONS],
        time=_time_table(found),
        size=f"{width} × {height}",
        machine=f"{machine['cpu']}, {machine['cores']} cores, Python {machine['python']}, "
        + ", ".join(f"{name} {version}" for name, version in machine["packages"].items()),
        missing=missing(),
        pictures=[_pictures(folder, view, keys) for view in views],
        flips=[_flips(folder, view, keys) for view in views],
        left=label((OURS, "fixed")),
        right="reference",
    )
    write_whole(folder / "index.html", lambda part: part.write_text(text, encoding="utf-8"))


def evaluated_scene(folder: Path) -> str:
    """Name of the scene that a folder's evaluation is of.

    Args:
        folder: of the report.

    Raises:
        UserError: the folder holds no evaluation, or a damaged one.
    """
    file = folder / "evaluation.json"
    try:
        found = json.loads(file.read_text())
        lacks = [name for name in _CONTENT if name not in found]
        if lacks:
            raise ValueError(f"no {lacks[0]}")
        return str(found["scene"])
    except FileNotFoundError:
        raise UserError(f"{folder}: holds no evaluation; make one with hybrid evaluate first") from None
    except (OSError, ValueError, TypeError) as error:
        raise UserError(f"{file}: is damaged ({error}); run hybrid evaluate again") from error


def label(key: Key) -> str:
    """A method as it is named in lists."""
    return key[0] if key[1] == "fixed" else f"{key[0]} ({key[1]})"


def _plots(plots: list[str | None]) -> list[Markup]:
    return [Markup(plot) for plot in plots if plot is not None]


def _sweep(sweep: dict[str, Any]) -> dict[str, Any]:
    """Title, plots and table of a sweep."""
    rows = sweep["rows"]
    columns = table(rows)
    for name in rows[0].get("quality", {}):
        digits = _DIGITS[name.split()[1]]
        columns[name] = [f"{row['quality'][name]:.{digits}f}" for row in rows]
    said = [sentence(row) for row in sweep["break_even"]]
    made = "" if "fovea" in columns else f", {sweep['fovea']} fovea"
    title = f"{sweep['scene']}, over {sweep['title']}{made}, {rows[0]['repeats']} frames each"
    return {
        "title": title,
        "plots": _plots(list(sweep_plots(sweep))),
        "columns": list(columns),
        "rows": list(zip(*columns.values(), strict=True)),
        "said": said,
    }


def _quality_table(found: dict[str, Any], region: str, keys: list[Key]) -> dict[str, Any]:
    names = [m for m in METRICS if mean_of(found, (OURS, "fixed"), region, m) is not None]
    rows = []
    for key in [*keys, (HALVES, "fixed")]:
        values = [mean_of(found, key, region, metric) for metric in names]
        cells = ["-" if v is None else f"{v:.{_DIGITS[m]}f}" for v, m in zip(values, names, strict=True)]
        rows.append({"method": key[0], "budget": key[1], "cells": cells, "ours": key[0].startswith("hybrid")})
    return {"region": region, "metrics": names, "rows": rows}


def _time_table(found: dict[str, Any]) -> dict[str, Any]:
    names = list(dict.fromkeys(name for row in found["time"] for name in row["passes"]))
    rows = []
    for row in found["time"]:
        cells = [f"{row['ms'][p]:.0f}" if p in row["ms"] else "-" for p in ("p50", "p95", "p99")]
        cells += [f"{1000 / row['ms']['p50']:.1f}", str(row["repeats"])]
        cells += [f"{row['passes'][name]:.0f}" if name in row["passes"] else "-" for name in names]
        rows.append({**row, "cells": cells, "ours": row["method"].startswith("hybrid")})
    return {"columns": ["p50", "p95", "p99", "FPS", "frames", *names], "rows": rows}


def _pictures(folder: Path, view: int, keys: list[Key]) -> dict[str, str]:
    names = {"reference": picture_name(view, None)}
    names |= {label(key): picture_name(view, key) for key in keys}
    return {name: _embedded(folder / file) for name, file in names.items()}


def _flips(folder: Path, view: int, keys: list[Key]) -> dict[str, str]:
    files = {label(key): folder / flip_name(view, key) for key in keys}
    return {name: _embedded(file) for name, file in files.items() if file.exists()}


def _embedded(file: Path) -> str:
    """A picture as a data URL."""
    buffer = io.BytesIO()
    PillowImage.open(file).convert("RGB").save(buffer, format="JPEG", quality=_JPEG_QUALITY, subsampling=0)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()
