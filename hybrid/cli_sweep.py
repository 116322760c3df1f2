"""`hybrid sweep`: tables and figures over one quantity at a time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from compose.errors import UserError
from hybrid.options import (
    Backend,
    DisplayName,
    ForestFile,
    FovA,
    FovB,
    Json,
    Law,
    SceneName,
    Size,
    Spp,
    loaded_scene,
    select,
    sized,
    write_json,
)
from hybrid.progress import progress_bar

_VIEWS = 4


def sweep(
    scene: SceneName,
    over: Annotated[
        str,
        typer.Option(
            help="What varies: resolution, aspect, radius, spp, view, band, layers, law, denoiser or trade."
        ),
    ] = "resolution",
    forest: ForestFile = None,
    fovea: Annotated[str, typer.Option(help="raw, denoised or fused.")] = "raw",
    size: Size = None,
    fov_a: FovA = 20.0,
    fov_b: FovB = 15.0,
    spp: Spp = 1,
    law: Law = "geisler-perry",
    display: DisplayName = "desktop",
    repeats: Annotated[int, typer.Option(help="Measured frames per method and row.", min=3)] = 15,
    warm_up: Annotated[int, typer.Option(help="Frames before that.", min=1)] = 2,
    report: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of an evaluation: its page gets this sweep as well."),
    ] = None,
    reference_spp: Annotated[
        int, typer.Option(help="Samples per pixel of references, where quality is measured.", min=4)
    ] = 64,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time hybrid frames against full path tracing, interleaved, over one quantity, beside FPC's figures."""
    from compose.foveation import Foveation, mode_named
    from compose.view import Gaze, display_named
    from hybrid.periphery import Viewing
    from hybrid.sweeps.catalogue import sweep_named
    from hybrid.sweeps.setting import Setting

    Foveation(Gaze(), fov_a, fov_b)
    if fov_a == 0:
        raise UserError("--fov-a 0.0: there is no fovea to time")
    mode_named(fovea)
    viewing = Viewing(display_named(display), law)
    sweep_named(over, (1,))
    if report is not None and not (report / "evaluation.json").exists():
        raise UserError(f"--report {report}: holds no evaluation; make one with hybrid evaluate first")
    select(backend)
    from hybrid.cache import forest_for
    from hybrid.evaluate.report import write_report
    from hybrid.sweeps.break_even import break_even, sentence
    from hybrid.sweeps.run import Effort, swept
    from hybrid.timing import machine
    from hybrid.trade import trade_file
    from pathtrace.views import unseen_views

    loaded = loaded_scene(scene)
    found = forest_for(loaded, forest)
    chosen = sweep_named(over, found.counts)
    camera = sized(loaded.camera, size)
    pixels = camera.width, camera.height
    views = unseen_views(loaded, _VIEWS, *pixels)
    base = Setting({}, camera, fov_a, fov_b, spp, fovea, viewing)
    effort = Effort(repeats, warm_up, reference_spp)
    with progress_bar(f"sweep over {over}") as bar:
        rows = swept(loaded, found, chosen.settings(base, views), chosen.judged, effort, bar)
    if over == "trade":
        write_json(trade_file(loaded, *pixels), rows)
    crossings = break_even(rows) if over == "radius" else []
    print(f"{loaded.name}: {chosen.title}" + ("" if "fovea" in rows[0] else f", {fovea} fovea"))
    _print(rows)
    for row in crossings:
        print(sentence(row))
    content = {
        "scene": loaded.name,
        "over": over,
        "title": chosen.title,
        "rows": rows,
        "break_even": crossings,
        "fovea": fovea,
        "fov_a": fov_a,
        "fov_b": fov_b,
        "spp": spp,
        "machine": machine(),
    }
    write_json(json_file, content)
    if report is not None:
        write_json(report / f"sweep-{over}.json", content)
        write_report(report)
        print(report / "index.html")


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
