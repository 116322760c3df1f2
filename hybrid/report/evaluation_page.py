"""The page of an evaluation: one file that requires no server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from compose.base.errors import UserError, one_line
from compose.base.files import write_whole
from compose.base.json_file import read_json
from hybrid.evaluation.equal_time import TOLERANCE
from hybrid.evaluation.keys import OURS_KEY
from hybrid.evaluation.results import foveal_metric_names, keys_of, label_of
from hybrid.evaluation.settings import FOVEAL_REFERENCE
from hybrid.evaluation.verdicts import WHOLE_METRIC, verdicts
from hybrid.measure.metrics.installed import missing
from hybrid.measure.regions import REGIONS
from hybrid.report.images import embedded_flips, embedded_images
from hybrid.report.plots import quality_over_time_plot, samples_plot
from hybrid.report.sweep_plots import sweep_plots
from hybrid.report.tables import quality_table, sweep_columns, time_table
from hybrid.sweeps.break_even import sentence

# What the page shows of evaluation.json.
_CONTENT = ("scene", "settings", "references", "methods", "quality", "time", "machine")


def write_report(folder: Path) -> None:
    """Writes index.html from evaluation.json, the images, and the sweeps in the same folder.

    Args:
        folder: of the report.
    """
    found = _read(folder / "evaluation.json")
    sweeps = [_read(file) for file in sorted(folder.glob("sweep-*.json"))]
    templates = Environment(loader=PackageLoader("hybrid.report", "."), autoescape=True)
    text = templates.get_template("evaluation.html").render(
        **_overview(found),
        **_plots_and_tables(found),
        **_viewer(found, folder),
        sweeps=[_sweep(sweep) for sweep in sweeps],
    )
    write_whole(folder / "index.html", lambda part: part.write_text(text, encoding="utf-8"))


def evaluated_scene(folder: Path) -> str:
    """Name of the scene that the evaluation in a folder is of.

    Args:
        folder: of the report.

    Raises:
        UserError: the folder holds no evaluation, or a damaged one.
    """
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


def _read(file: Path) -> Any:
    try:
        return read_json(file, finite=False)
    except (OSError, ValueError) as error:
        raise UserError(f"{file}: is damaged ({one_line(error)}); delete it and make it again") from error


def _overview(found: dict[str, Any]) -> dict[str, Any]:
    """Title, verdicts, and what was measured with what."""
    settings, machine = found["settings"], found["machine"]
    packages = ", ".join(f"{name} {version}" for name, version in machine["packages"].items())
    return {
        "title": f"Evaluation of {found['scene']}",
        "subtitle": (
            f"{settings['width']} × {settings['height']}, samples per pixel in the disc: {settings['spp']}, "
            f"fov-a {settings['fov_a']:g} %, fov-b {settings['fov_b']:g} % of the height, "
            f"{len(_views(found))} views. References: {settings['reference_spp']} samples per pixel, "
            f"{FOVEAL_REFERENCE * settings['reference_spp']} in the disc, denoised."
        ),
        "verdicts": verdicts(found),
        # Evaluations of earlier versions have none.
        "plan": found.get("plan", {}),
        "reference_note": _reference_note(found),
        "tolerance": f"{100 * TOLERANCE:g}",
        "size": f"{settings['width']} × {settings['height']}",
        "machine": f"{machine['cpu']}, {machine['cores']} cores, Python {machine['python']}, {packages}",
        "missing": missing(),
    }


def _reference_note(found: dict[str, Any]) -> str:
    psnr = {n: [r["psnr"] for r in found["references"] if r["region"] == n] for n in ("whole", "foveal")}
    return (
        f"Against the truth, the references have {min(psnr['whole']):.1f} to {max(psnr['whole']):.1f} dB "
        f"over the whole frame and {min(psnr['foveal']):.1f} to {max(psnr['foveal']):.1f} dB in the fovea, "
        "denoising bias included."
    )


def _plots_and_tables(found: dict[str, Any]) -> dict[str, Any]:
    """Quality over time, foveal quality over samples, and the tables of quality and time."""
    metrics, keys = foveal_metric_names(found), keys_of(found)
    over_time = [quality_over_time_plot(found, "foveal", metric) for metric in metrics]
    over_time.append(quality_over_time_plot(found, "whole", WHOLE_METRIC))
    return {
        "over_time": _markup(over_time),
        "samples": _markup([samples_plot(found, metric) for metric in metrics]),
        "quality": [quality_table(found, region, keys) for region in REGIONS],
        "time": time_table(found),
    }


def _viewer(found: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The images, and the circles drawn over them in percent of the height."""
    settings, views, keys = found["settings"], _views(found), keys_of(found)
    labels = {key.label: label_of(found, key) for key in keys}

    def labelled(urls: dict[str, str]) -> dict[str, str]:
        return {labels.get(name, name): url for name, url in urls.items()}

    width, height = settings["width"], settings["height"]
    return {
        "views": views,
        "images": [labelled(embedded_images(folder, view, keys)) for view in views],
        "flips": [labelled(embedded_flips(folder, view, keys)) for view in views],
        "left": OURS_KEY.label,
        "right": "reference",
        "aspect": 100 * width / height,
        "gaze_x": 100 * settings["gaze_x"] * width / height,
        "gaze_y": 100 * settings["gaze_y"],
        "fov_a": settings["fov_a"],
        "fov_b": settings["fov_b"],
    }


def _views(found: dict[str, Any]) -> list[int]:
    return sorted({row["view"] for row in found["quality"]})


def _sweep(sweep: dict[str, Any]) -> dict[str, Any]:
    """Title, plots, sentences and table of a sweep."""
    rows = sweep["rows"]
    columns = sweep_columns(rows)
    fovea = "" if "fovea" in columns else f", {sweep['fovea']} fovea"
    return {
        "title": f"{sweep['scene']}, over {sweep['title']}{fovea}, {rows[0]['repeats']} frames each",
        "views": _views_note(sweep),
        "plots": _markup(sweep_plots(sweep)),
        "columns": list(columns),
        "rows": list(zip(*columns.values(), strict=True)),
        "sentences": [sentence(row) for row in sweep["break_even"]],
    }


def _views_note(sweep: dict[str, Any]) -> str:
    """What the figures of a sweep are of; files of earlier versions do not say."""
    count = sweep.get("views", 1)
    if count == 1:
        return "Each row is of a single view." if "views" in sweep else ""
    return (
        f"Frames of {count} views that nothing was fitted to: times are medians of all their frames, quality "
        "is the mean over the views; in brackets the least and the greatest value of a view."
    )


def _markup(plots: list[str] | list[str | None]) -> list[Markup]:
    """SVG elements that jinja does not escape, without those that could not be plotted."""
    return [Markup(plot) for plot in plots if plot is not None]
