"""`hybrid sweep`: tables and figures over one quantity."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from compose.base.errors import UserError
from hybrid.cli import options as o
from hybrid.cli.many_machines import chosen_part, on_ray, said_part
from hybrid.cli.progress import progress_bar
from hybrid.evaluation.sweep_catalogue import Setting, SweepEffort, sweep_named
from hybrid.render.frame_settings import SWEEP


def sweep(
    context: typer.Context,
    scene: o.SceneName,
    over: Annotated[
        str,
        typer.Option(
            help="resolution, aspect, radius, spp, view, band, layers, acuity, denoiser, paths or trade."
        ),
    ] = "resolution",
    forest: o.ForestFile = None,
    fovea: Annotated[str, o.frame(help="raw, denoised or fused.")] = SWEEP.fovea.value,
    size: o.Size = None,
    fov_a: o.FovA = SWEEP.fov_a,
    fov_b: o.FovB = SWEEP.fov_b,
    spp: o.Spp = SWEEP.spp,
    acuity_model: o.AcuityModelName = SWEEP.acuity_model,
    integrator: o.IntegratorName = None,
    display: o.DisplayName = "desktop",
    repeats: o.Repeats = 15,
    warm_up: o.WarmUp = 2,
    report: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of an evaluation; its page also gets this sweep."),
    ] = None,
    reference_spp: o.ReferenceSpp = 64,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    backend: o.Backend = "auto",
    part: o.PartName = None,
    ray: o.RayAddress = None,
    shared: o.SharedFolder = None,
    json_file: o.Json = None,
) -> None:
    """Time hybrid frames and full path tracing in turns, over one quantity; resumes if interrupted.

    Options that a sweep sets itself are refused: --size by resolution, aspect, radius, spp and view; --spp by
    spp, denoiser, paths and trade; --fovea by denoiser, paths and trade; --fov-a and --fov-b by band;
    --acuity-model by acuity. In radius, spp, view and trade, only the ratio of --fov-a and --fov-b matters.
    Only band, layers, acuity, denoiser, paths and trade use --reference-spp.
    """
    for name in sweep_named(over, (1,)).ignored:
        if o.given(context, name):
            option = f"--{name.replace('_', '-')}"
            raise UserError(f"{option}: has no influence on a sweep --over {over}; leave it out")
    settings = replace(
        SWEEP,
        fov_a=fov_a,
        fov_b=fov_b,
        spp=spp,
        fovea=fovea,
        acuity_model=acuity_model,
        display=display,
        integrator=integrator,
    )
    o.require_both(part, shared)
    if report is not None and part is not None:
        raise UserError("--report: has no influence on parts; leave it out")
    if ray is not None:
        o.write_json(json_file, on_ray(ray, part, shared, is_timed=True))
        return
    mine = chosen_part(part)
    if mine is not None and json_file is not None:
        raise UserError("--json: has no influence on a part; hybrid merge has it, too")
    if fov_a == 0:
        raise UserError("--fov-a 0.0: there is no fovea to time")
    o.select(backend)
    from hybrid.base.parts import first_come
    from hybrid.evaluation.evaluation_page import evaluated_scene, write_report
    from hybrid.evaluation.sweep_run import sweep as run
    from hybrid.evaluation.sweep_run import sweep_part
    from hybrid.preparation.preparation import with_forest

    loaded = o.loaded_scene(scene, None, thin_glass, sensor)
    if report is not None:
        evaluated = evaluated_scene(report)
        if evaluated != loaded.name:
            raise UserError(f"--report {report}: holds an evaluation of {evaluated}, not of {loaded.name}")
        o.check_writable(report / "index.html")
    base = Setting(o.sized(loaded.camera, size), settings)
    # What is not there yet is made by one part.
    with nullcontext() if shared is None else first_come(shared):
        loaded, found = with_forest(loaded, forest, progress_bar)
        o.fill_irradiance(loaded, settings)
    effort = SweepEffort(repeats, warm_up, reference_spp)
    if mine is not None and shared is not None:
        with progress_bar(f"sweep over {over}, {mine}") as bar:
            stored = sweep_part(loaded, found, over, base, effort, (shared, mine), bar)
        said_part(stored)
        return

    def write(content: dict[str, Any]) -> None:
        o.write_json(json_file, content)
        if report is not None:
            o.write_json(report / f"sweep-{over}.json", content)

    with progress_bar(f"sweep over {over}") as bar:
        content = run(loaded, found, over, base, effort, write, bar)
    print_sweep(content, settings.fovea.value)
    if report is not None:
        write_report(report)
        print(report / "index.html")


def print_sweep(content: dict[str, Any], fovea: str) -> None:
    """Prints a sweep as a table, with the mode of its fovea unless it varies."""
    from hybrid.evaluation.sweep_catalogue import sentence, table

    rows = content["rows"]
    made = "" if "fovea" in rows[0] else f", {fovea} fovea"
    print(f"{content['scene']}: {content['title']}{made}")
    columns = table(rows, dict.fromkeys(("ssim", "flip", "jod"), ".4g"))
    widths = [max(map(len, [name, *cells])) + 2 for name, cells in columns.items()]
    for line in [list(columns), *zip(*columns.values(), strict=True)]:
        print("".join(f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True)))
    for row in content["break_even"]:
        print(sentence(row))
