"""`hybrid bench integrator`."""

from __future__ import annotations

from hybrid.cli.options import (
    Backend,
    Json,
    MaxDepth,
    ReferenceSpp,
    Repeats,
    SceneName,
    Size,
    ThinGlass,
    loaded_scene,
    select,
    sized,
    write_json,
)
from hybrid.runtime.progress import progress_bar


def integrator(
    scene: SceneName,
    size: Size = (256, 256),
    reference_spp: ReferenceSpp = 1024,
    repeats: Repeats = 7,
    max_depth: MaxDepth = None,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Compare error, time and bias of both integrators on raw frames."""
    select(backend)
    from hybrid.bench.integrator import bench_integrator
    from hybrid.runtime.machine import machine

    loaded = loaded_scene(scene, max_depth, thin_glass)
    with progress_bar("bench (samples)") as bar:
        found = bench_integrator(loaded, sized(loaded.camera, size), reference_spp, repeats, bar)
    cache = found["cache"]
    print(f"cache: {cache['cells']:,} cells, {cache['bytes'] / 2**20:.1f} MiB, {cache['seconds']:.1f} s")
    transfer = f"{cache['transfer_bytes'] / 2**20:.1f} MiB"
    print(f"{cache['look_up_ns']:.0f} ns per look-up; {transfer} more to follow lights")
    print("integrator  spp  squared error       ms  efficiency")
    for row in found["rows"]:
        print(
            f"{row['integrator']:<10}{row['spp']:>5}{row['squared_error']:>15.4g}"
            f"{row['ms']['p50']:>9.1f}{row['efficiency']:>12.2f}"
        )
    print(f"bias against {reference_spp} spp     mean  worst block  95 % of blocks below")
    for row in found["bias"]:
        print(
            f"{row['integrator']:<22}{row['mean']:>+9.2%}{row['worst_block']:>13.1%}{row['p95_block']:>22.1%}"
        )
    write_json(json_file, {**found, "scene": loaded.name, "machine": machine()})
