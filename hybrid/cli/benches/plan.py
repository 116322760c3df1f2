"""`hybrid bench plan`."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import typer

from hybrid.cli.options import (
    MOST_FRAMES,
    Backend,
    DisplayName,
    FixedSize,
    Json,
    ReferenceSpp,
    Repeats,
    SceneName,
    Seed,
    ThinGlass,
    select,
    sized,
    write_json,
)
from hybrid.runtime.progress import progress_bar


def plan(
    scene: SceneName,
    size: FixedSize = (512, 512),
    display: DisplayName = "desktop",
    iterations: Annotated[
        int, typer.Option(help="Training steps with fixed settings; others train as long.", min=8)
    ] = 300,
    views: Annotated[int, typer.Option(help="Training views.", min=4, max=MOST_FRAMES)] = 40,
    side: Annotated[int, typer.Option(help="Side of their frames in pixels.", min=32)] = 192,
    reference_spp: ReferenceSpp = 128,
    repeats: Repeats = 20,
    thin_glass: ThinGlass = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Measure what each decision of a plan gains and loses, alone and together; resumes if interrupted."""
    select(backend)
    from compose.eye.display import display_named
    from hybrid.bench.plan import Effort, bench_plan
    from hybrid.frame.settings import DEFAULTS
    from hybrid.plan.plan import plan_of
    from hybrid.runtime.device import device_arrays
    from hybrid.runtime.machine import machine
    from hybrid.store.cache import scene_folder
    from pathtrace.scene.scene import load_scene

    shown = display_named(display)
    # Not as planned: each row has its own paths.
    loaded = load_scene(scene, None, thin_glass)
    with progress_bar("plan (parts)") as bar:
        found = plan_of(loaded, shown, size, seed=seed, progress=bar)
    settings = replace(DEFAULTS, camera=sized(loaded.camera, size), display=shown)
    effort = Effort(iterations, views, side, reference_spp=reference_spp, repeats=repeats, seed=seed)
    folder = scene_folder(loaded.name, loaded.own_hash) / f"plan-{size[0]}-{size[1]}-{iterations}-{seed}"
    rows = bench_plan(loaded, found, settings, effort, folder, device_arrays().backend, progress_bar)
    _print(rows)
    content = {"scene": loaded.name, "size": size, "decisions": found.rows(), "rows": rows}
    write_json(json_file, {**content, "machine": machine()})


def _print(rows: list[dict[str, Any]]) -> None:
    print(
        f"{'decision':<16}{'value':>9}    PSNR    SSIM  foveal          ms    p95  training      file  steps"
    )
    for row in rows:
        value = "" if row["value"] is None else str(row["value"])
        print(
            f"{row['decision']:<16}{value:>9}{row['psnr']:8.2f}{row['ssim']:8.4f}{row['foveal_psnr']:8.2f}"
            f"{row['frame_ms']['p50']:12.1f}{row['frame_ms']['p95']:7.1f}{row['training_mib']:6.0f} MiB"
            f"{row['file_bytes'] / 1e6:7.2f} MB{row['steps']:7}"
        )
