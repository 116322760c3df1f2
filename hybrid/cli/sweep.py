"""`hybrid sweep`: tables and figures over one quantity at a time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from compose.base.errors import UserError
from compose.eye.acuity import DEFAULT_ACUITY_MODEL
from hybrid.cli.options import (
    Backend,
    DisplayName,
    ForestFile,
    Json,
    SceneName,
    loaded_scene,
    select,
    sized,
    write_json,
)
from hybrid.runtime.progress import progress_bar

_VIEWS = 4
# Of the options that a sweep may set itself. They stand here, so that one that was given can be told.
_DEFAULTS: dict[str, Any] = {
    "--fovea": "raw",
    "--size": None,
    "--fov-a": 20.0,
    "--fov-b": 15.0,
    "--spp": 1,
    "--acuity-model": DEFAULT_ACUITY_MODEL,
    "--reference-spp": 64,
}


def sweep(
    scene: SceneName,
    over: Annotated[
        str,
        typer.Option(
            help="What varies: resolution, aspect, radius, spp, view, band, layers, acuity model, denoiser or trade."
        ),
    ] = "resolution",
    forest: ForestFile = None,
    fovea: Annotated[
        str | None, typer.Option(help="raw, denoised or fused; denoiser and trade set it. Default: raw.")
    ] = None,
    size: Annotated[
        tuple[int, int] | None,
        typer.Option(
            metavar="W H",
            help="Frame size; resolution, aspect, radius, spp and view set it. Default: the scene's.",
        ),
    ] = None,
    fov_a: Annotated[
        float | None,
        typer.Option(
            help="Radius of the path-traced disc, percent of the height; band sets it, and in radius, spp, "
            "view and trade it counts only how much larger than --fov-b it is. Default: 20."
        ),
    ] = None,
    fov_b: Annotated[
        float | None,
        typer.Option(help="Radius inside of which no splats are drawn, percent; as --fov-a. Default: 15."),
    ] = None,
    spp: Annotated[
        int | None,
        typer.Option(
            help="Samples per pixel in the disc; spp, denoiser and trade set it. Default: 1.", min=1
        ),
    ] = None,
    acuity_model: Annotated[
        str | None,
        typer.Option(
            help="What the eye resolves: geisler-perry, stelacsf, fov-gs or none; acuity model sets it. "
            f"Default: {DEFAULT_ACUITY_MODEL}."
        ),
    ] = None,
    display: DisplayName = "desktop",
    repeats: Annotated[int, typer.Option(help="Measured frames per method and row.", min=3)] = 15,
    warm_up: Annotated[int, typer.Option(help="Frames before that.", min=1)] = 2,
    report: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of an evaluation: its page gets this sweep as well."),
    ] = None,
    reference_spp: Annotated[
        int | None,
        typer.Option(
            help="Samples per pixel of references; band, layers, acuity model, denoiser and trade have some. "
            "Default: 64.",
            min=4,
        ),
    ] = None,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time hybrid frames in turns with full path tracing, over one quantity; goes on where it stopped."""
    from compose.eye.display import display_named
    from compose.eye.gaze import Gaze
    from compose.fovea.mode import mode_named
    from compose.fovea.region import Foveation
    from hybrid.frame.periphery import Viewing
    from hybrid.sweeps.setting import Setting

    given: dict[str, Any] = {
        "--fovea": fovea,
        "--size": size,
        "--fov-a": fov_a,
        "--fov-b": fov_b,
        "--spp": spp,
        "--acuity-model": acuity_model,
        "--reference-spp": reference_spp,
    }
    values = _completed(over, given)
    radii = values["--fov-a"], values["--fov-b"]
    Foveation(Gaze(), *radii)
    if radii[0] == 0:
        raise UserError("--fov-a 0.0: there is no fovea to time")
    mode_named(values["--fovea"])
    viewing = Viewing(display_named(display), values["--acuity-model"])
    select(backend)
    from hybrid.plan.trade import remember_trade, trade_identity
    from hybrid.report.evaluation_page import write_report
    from hybrid.runtime.machine import machine
    from hybrid.store.cache import scene_folder
    from hybrid.store.identity import short_hash
    from hybrid.store.journal import Journal
    from hybrid.sweeps.break_even import break_even, sentence
    from hybrid.sweeps.catalogue import sweep_named
    from hybrid.sweeps.record import applied, identity_of
    from hybrid.sweeps.run import Effort, swept
    from hybrid.training.quick import forest_for
    from pathtrace.dataset.views import unseen_views

    loaded = loaded_scene(scene)
    if report is not None:
        _check_report(report, loaded.name)
    camera = sized(loaded.camera, size)
    found = forest_for(loaded, forest)
    chosen = sweep_named(over, found.counts)
    views = unseen_views(loaded, _VIEWS, camera.width, camera.height)
    base = Setting({}, camera, *radii, values["--spp"], values["--fovea"], viewing)
    effort = Effort(repeats, warm_up, values["--reference-spp"])
    settings = chosen.settings(base, views)
    identity = identity_of(loaded, found, chosen, settings, effort)
    folder = scene_folder(loaded.name, loaded.hash)
    journal = Journal(folder / f"sweep-{over}-{short_hash(identity)}.json", identity)
    with progress_bar(f"sweep over {over}") as bar:
        rows = swept(loaded, found, settings, chosen.judged, effort, journal, bar)
    if over == "trade":
        pixels = camera.width, camera.height
        remember_trade(
            loaded, trade_identity(loaded, found, pixels, viewing.acuity_model, viewing.display), rows
        )
    crossings = break_even(rows) if over == "radius" else []
    print(f"{loaded.name}: {chosen.title}" + ("" if "fovea" in rows[0] else f", {base.fovea} fovea"))
    _print(rows)
    for row in crossings:
        print(sentence(row))
    content = {
        "scene": loaded.name,
        "forest": found.digest(),
        "over": over,
        "title": chosen.title,
        "rows": rows,
        "break_even": crossings,
        **applied(chosen, base, effort),
        "machine": machine(),
    }
    write_json(json_file, content)
    if report is not None:
        write_json(report / f"sweep-{over}.json", content)
        write_report(report)
        print(report / "index.html")
    journal.remove()


def _completed(over: str, given: dict[str, Any]) -> dict[str, Any]:
    """The options with their defaults; one that was given and changes nothing is refused."""
    from hybrid.sweeps.catalogue import sweep_named

    for option in sweep_named(over, (1,)).ignored:
        if given[option] is not None:
            raise UserError(f"{option}: changes nothing in a sweep --over {over}; leave it out")
    return {option: _DEFAULTS[option] if value is None else value for option, value in given.items()}


def _check_report(folder: Path, scene: str) -> None:
    """Refuses a page that this sweep does not belong on, or that cannot be written."""
    from hybrid.output.images import check_writable
    from hybrid.report.evaluation_page import evaluated_scene

    evaluated = evaluated_scene(folder)
    if evaluated != scene:
        raise UserError(f"--report {folder}: holds an evaluation of {evaluated}, not of {scene}")
    check_writable(folder / "index.html")


def _print(rows: list[dict[str, Any]]) -> None:
    """The table, and quality if there is any."""
    from hybrid.sweeps.table import table

    columns = table(rows)
    for name in rows[0].get("quality", {}):
        if name.split()[1] in ("ssim", "flip", "jod"):
            columns[name] = [f"{row['quality'][name]:.4g}" for row in rows]
    widths = [max(map(len, [name, *cells])) + 2 for name, cells in columns.items()]
    for line in [list(columns), *zip(*columns.values(), strict=True)]:
        print("".join(f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True)))
