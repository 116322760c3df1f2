"""`hybrid bench moving`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid.cli.options import (
    Backend,
    FixedSize,
    ForestFile,
    Json,
    ReferenceSpp,
    SceneName,
    Spp,
    ThinGlass,
    loaded_scene,
    select,
    sized,
    write_json,
)
from hybrid.frame.settings import INTERACTIVE
from hybrid.runtime.progress import progress_bar


def moving(
    scene: SceneName,
    forest: ForestFile = None,
    size: FixedSize = (320, 240),
    spp: Spp = INTERACTIVE.spp,
    reference_spp: ReferenceSpp = 128,
    against: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FOREST",
            help="Forest to compare with, named by its file; drawn as splats alone. May be given repeatedly.",
        ),
    ] = None,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Play a scene that moves, as in the window, and compare its frames with other methods, by region."""
    select(backend)
    from hybrid.bench.moving import bench_moving, require_moving
    from hybrid.preparation.quick import forest_for
    from hybrid.runtime.machine import machine
    from splat.io.forest_file import load_forest

    loaded = loaded_scene(scene, None, thin_glass)
    require_moving(loaded)
    settings = replace(INTERACTIVE, spp=spp, camera=sized(loaded.camera, size))
    found = forest_for(loaded, forest)
    others = {file.stem: load_forest(file) for file in against or ()}
    with progress_bar("bench (clips)") as bar:
        rows = bench_moving(loaded, found, settings, reference_spp, bar, others)
    _print(rows)
    write_json(
        json_file, {"scene": loaded.name, "size": size, "spp": spp, "rows": rows, "machine": machine()}
    )


def _print(rows: list[dict[str, Any]]) -> None:
    names = list(dict.fromkeys(row["region"] for row in rows))
    print(f"{'method':<23}" + "".join(f"{name:>11}" for name in names) + "     ms    p95  ratio")
    by_method: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        by_method.setdefault(row["method"], {})[row["region"]] = row
    for method, own in by_method.items():
        cells = "".join(f"{own[name]['psnr']:8.2f} dB" if name in own else " " * 11 for name in names)
        first = next(iter(own.values()))
        print(f"{method:<23}{cells}{first['ms']['p50']:7.1f}{first['ms']['p95']:7.1f}{first['ratio']:7.2f}")
    for method, own in by_method.items():
        more = [f"{row['jod']:.2f} JOD ({name})" for name, row in own.items() if row.get("jod") is not None]
        shift = own.get("moving", {}).get("registration_px")
        more += [] if shift is None else [f"what moves is off by {shift:.2f} px"]
        if more:
            print(f"{method}: {', '.join(more)}")
