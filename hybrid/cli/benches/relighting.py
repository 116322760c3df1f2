"""`hybrid bench relighting`."""

from __future__ import annotations

from hybrid.cli.options import (
    Backend,
    Json,
    MaxDepth,
    ReferenceSpp,
    SceneName,
    Size,
    ThinGlass,
    loaded_scene,
    select,
    sized,
    write_json,
)
from hybrid.runtime.progress import progress_bar


def relighting(
    scene: SceneName,
    size: Size = (256, 256),
    reference_spp: ReferenceSpp = 512,
    max_depth: MaxDepth = None,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Dim the strongest light by half, and see how soon a cache that follows it is as good as a new one."""
    select(backend)
    from hybrid.bench.relighting import bench_relighting
    from hybrid.frame.irradiance import filled_cache
    from hybrid.runtime.machine import machine

    loaded = loaded_scene(scene, max_depth, thin_glass)
    with progress_bar("bench (samples)") as bar:
        found = bench_relighting(loaded, sized(loaded.camera, size), filled_cache(loaded), reference_spp, bar)
    if found["rows"]:
        print(f"{found['update_ms']['p50']:.1f} ms per update")
        print("cache         squared relative bias")
    else:
        print(f"{loaded.name}: nothing to follow; no light has a strength, or no surface is lit")
    for row in found["rows"]:
        print(f"{row['cache']:<14}{row['squared_bias']:.3g}")
    write_json(json_file, {**found, "scene": loaded.name, "machine": machine()})
