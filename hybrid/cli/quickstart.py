"""`hybrid quickstart`: the main job, from nothing to images and numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from compose.base.errors import UserError
from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import DEFAULTS, FrameSettings


def quickstart(
    scene: Annotated[str, typer.Argument(metavar="[SCENE]")] = "room",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for images, page and numbers.")] = Path(
        "out"
    ),
    fov_a: o.FovA = DEFAULTS.fov_a,
    fov_b: o.FovB = DEFAULTS.fov_b,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    override: o.Override = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
    json_file: o.Json = None,
) -> None:
    """Capture, train, render and measure: the main job, from nothing to images and numbers."""
    settings = FrameSettings(fov_a=fov_a, fov_b=fov_b)
    o.select(backend)
    from hybrid.evaluation.quickstart_job import SIZE
    from hybrid.evaluation.quickstart_job import quickstart as run

    if not settings.foveation.region(SIZE, SIZE).count:
        raise UserError(f"--fov-a {fov_a}: there is no fovea to show, it holds no pixel of {SIZE} x {SIZE}")
    o.check_writable(out / "result.json")
    result = run(
        o.planned_scene(scene, None, thin_glass, sensor, override), out, settings, seed, progress_bar
    )
    o.write_json(out / "result.json", result)
    o.write_json(json_file, result)
    print(
        f"hybrid {result['hybrid']['psnr']:.2f} dB, splats {result['splats_alone']['psnr']:.2f} dB, "
        f"{result['ratio']:.2f} x faster than full path tracing, {result['seconds']['total']:.0f} s in total"
    )
    print(f"Open {out / 'index.html'}")
