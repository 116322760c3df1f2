"""`hybrid sweep`: tables and figures over one quantity."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from compose.base.errors import UserError
from hybrid.cli.options import (
    FRAME,
    MEASUREMENT,
    MOST_REFERENCE_SPP,
    VIEWER,
    Backend,
    DisplayName,
    ForestFile,
    IntegratorName,
    Json,
    Repeats,
    SceneName,
    ThinGlass,
    WarmUp,
    fill_irradiance,
    loaded_scene,
    select,
    sized,
    write_json,
)
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import MOST_SPP, SWEEP, FrameSettings

# Defaults of what a sweep may set itself. They are applied here, so that an option that was given is known.
_DEFAULTS: dict[str, Any] = {
    "fovea": SWEEP.fovea.value,
    "size": None,
    "fov_a": SWEEP.fov_a,
    "fov_b": SWEEP.fov_b,
    "spp": SWEEP.spp,
    "acuity_model": SWEEP.acuity_model,
    "reference_spp": 64,
}


def sweep(
    scene: SceneName,
    over: Annotated[
        str,
        typer.Option(help="resolution, aspect, radius, spp, view, band, layers, acuity, denoiser or trade."),
    ] = "resolution",
    forest: ForestFile = None,
    fovea: Annotated[
        str | None,
        typer.Option(
            help=f"raw, denoised or fused; set by denoiser and trade. Default: {_DEFAULTS['fovea']}.",
            rich_help_panel=FRAME,
        ),
    ] = None,
    size: Annotated[
        tuple[int, int] | None,
        typer.Option(
            metavar="W H",
            help="Frame size; set by resolution, aspect, radius, spp and view. Default: the scene's.",
            rich_help_panel=FRAME,
        ),
    ] = None,
    fov_a: Annotated[
        float | None,
        typer.Option(
            help="Radius of the path-traced disc, percent of the height; set by band. In radius, spp, view "
            f"and trade only its ratio to --fov-b matters. Default: {_DEFAULTS['fov_a']:g}.",
            rich_help_panel=FRAME,
        ),
    ] = None,
    fov_b: Annotated[
        float | None,
        typer.Option(
            help="Radius inside of which no splats are visible, percent; set like --fov-a. "
            f"Default: {_DEFAULTS['fov_b']:g}.",
            rich_help_panel=FRAME,
        ),
    ] = None,
    spp: Annotated[
        int | None,
        typer.Option(
            help="Samples per pixel in the disc; set by spp, denoiser and trade. "
            f"Default: {_DEFAULTS['spp']}.",
            min=1,
            max=MOST_SPP,
            rich_help_panel=FRAME,
        ),
    ] = None,
    acuity_model: Annotated[
        str | None,
        typer.Option(
            help="fovvideovdp, geisler-perry, stelacsf, fov-gs or none; set by acuity. "
            f"Default: {_DEFAULTS['acuity_model']}.",
            rich_help_panel=VIEWER,
        ),
    ] = None,
    integrator: IntegratorName = None,
    display: DisplayName = "desktop",
    repeats: Repeats = 15,
    warm_up: WarmUp = 2,
    report: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of an evaluation, whose page gets this sweep as well."),
    ] = None,
    reference_spp: Annotated[
        int | None,
        typer.Option(
            help="Samples per pixel of references; used by band, layers, acuity, denoiser and trade. "
            f"Default: {_DEFAULTS['reference_spp']}.",
            min=4,
            max=MOST_REFERENCE_SPP,
            rich_help_panel=MEASUREMENT,
        ),
    ] = None,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time hybrid frames and full path tracing in turns, over one quantity; resumes if interrupted."""
    given = dict(zip(_DEFAULTS, (fovea, size, fov_a, fov_b, spp, acuity_model, reference_spp), strict=True))
    values = _completed(over, given)
    named = {name: values[name] for name in ("fov_a", "fov_b", "spp", "fovea", "acuity_model")}
    settings = replace(SWEEP, **named, display=display, integrator=integrator)
    if settings.fov_a == 0:
        raise UserError("--fov-a 0.0: there is no fovea to time")
    select(backend)
    from hybrid.evaluation.sweep_catalogue import Effort, Setting
    from hybrid.evaluation.sweep_run import sweep as run
    from hybrid.preparation.preparation import with_forest

    loaded = loaded_scene(scene, None, thin_glass)
    if report is not None:
        _check_report(report, loaded.name)
    base = Setting(sized(loaded.camera, size), settings)
    effort = Effort(repeats, warm_up, values["reference_spp"])
    loaded, found = with_forest(loaded, forest, progress_bar)
    fill_irradiance(loaded, settings)

    def write(content: dict[str, Any]) -> None:
        write_json(json_file, content)
        if report is not None:
            write_json(report / f"sweep-{over}.json", content)

    with progress_bar(f"sweep over {over}") as bar:
        content = run(loaded, found, over, base, effort, write, bar)
    _print(content, settings)
    if report is not None:
        _update_page(report)


def _completed(over: str, given: dict[str, Any]) -> dict[str, Any]:
    """The options with their defaults; one that was given without any influence is refused."""
    from hybrid.evaluation.sweep_catalogue import sweep_named

    for name in sweep_named(over, (1,)).ignored:
        if given[name] is not None:
            option = f"--{name.replace('_', '-')}"
            raise UserError(f"{option}: has no influence on a sweep --over {over}; leave it out")
    return {name: _DEFAULTS[name] if value is None else value for name, value in given.items()}


def _check_report(folder: Path, scene: str) -> None:
    """Refuses a report that this sweep does not belong to, or that cannot be written."""
    from hybrid.evaluation.evaluation_page import evaluated_scene
    from hybrid.render.image_files import check_writable

    evaluated = evaluated_scene(folder)
    if evaluated != scene:
        raise UserError(f"--report {folder}: holds an evaluation of {evaluated}, not of {scene}")
    check_writable(folder / "index.html")


def _update_page(folder: Path) -> None:
    from hybrid.evaluation.evaluation_page import write_report

    write_report(folder)
    print(folder / "index.html")


def _print(content: dict[str, Any], settings: FrameSettings) -> None:
    """The table, with quality if it was measured, and where hybrid frames break even."""
    from hybrid.evaluation.sweep_tables import quality_cells, sentence, table

    rows = content["rows"]
    made = "" if "fovea" in rows[0] else f", {settings.fovea.value} fovea"
    print(f"{content['scene']}: {content['title']}{made}")
    columns = table(rows)
    for name in rows[0].get("quality", {}):
        if name.split()[1] in ("ssim", "flip", "jod"):
            columns[name] = quality_cells(rows, name, ".4g")
    widths = [max(map(len, [name, *cells])) + 2 for name, cells in columns.items()]
    for line in [list(columns), *zip(*columns.values(), strict=True)]:
        print("".join(f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True)))
    for row in content["break_even"]:
        print(sentence(row))
