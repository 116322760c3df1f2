"""`hybrid bench passes`."""

from __future__ import annotations

from hybrid.cli.options import (
    Backend,
    ForestFile,
    FovA,
    FovB,
    Json,
    Repeats,
    SceneName,
    Size,
    Spp,
    ThinGlass,
    WarmUp,
    loaded_scene,
    select,
    sized,
    write_json,
)
from hybrid.frame.settings import DEFAULTS, FrameSettings
from hybrid.runtime.progress import progress_bar


def passes(
    scene: SceneName,
    forest: ForestFile = None,
    size: Size = None,
    fov_a: FovA = DEFAULTS.fov_a,
    fov_b: FovB = DEFAULTS.fov_b,
    spp: Spp = 2,
    repeats: Repeats = 15,
    warm_up: WarmUp = 3,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time each pass of a frame with a raw, a denoised and a fused fovea, interleaved."""
    settings = FrameSettings(fov_a=fov_a, fov_b=fov_b, spp=spp)
    select(backend)
    from dataclasses import replace

    from hybrid.bench.passes import bench_passes
    from hybrid.preparation.quick import forest_for
    from hybrid.runtime.machine import machine

    loaded = loaded_scene(scene, None, thin_glass)
    settings = replace(settings, camera=sized(loaded.camera, size))
    found = forest_for(loaded, forest)
    with progress_bar("bench (rounds)") as bar:
        rows = bench_passes(loaded, found, settings, repeats, warm_up, bar)
    names = list(rows[0]["passes"])
    columns = "".join(f"{name:>9}" for name in names)
    print(f"fovea    {columns}   made / traced  over raw   (median ms)")
    for row in rows:
        times = "".join(f"{row['passes'][name]['p50']:>9.1f}" for name in names)
        print(f"{row['mode']:<9}{times}   {row['share_of_tracing']:>13.1%} {row['over_raw']:>9.1%}")
    write_json(json_file, [{**row, "scene": loaded.name, "machine": machine()} for row in rows])
