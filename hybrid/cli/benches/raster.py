"""`hybrid bench raster`."""

from __future__ import annotations

from typing import Annotated

import typer

from hybrid.cli.options import (
    MOST_FRAMES,
    MOST_GAUSSIANS,
    Backend,
    FixedSize,
    Json,
    Seed,
    require_size,
    select,
    write_json,
)
from hybrid.runtime.progress import progress_bar

_WARM_UP = 5


def raster(
    gaussians: Annotated[int, typer.Option(min=1, max=MOST_GAUSSIANS)] = 50_000,
    size: FixedSize = (512, 512),
    seed: Seed = 0,
    repeats: Annotated[int, typer.Option(help="Measured rounds.", min=3, max=MOST_FRAMES)] = 50,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time the rasterizer and its gradient on random Gaussians that are already on the device."""
    require_size(size)
    select(backend)
    from hybrid.bench.raster import bench_raster
    from hybrid.runtime.machine import machine

    with progress_bar("bench (rounds)") as bar:
        row = bench_raster(gaussians, size, seed, repeats, _WARM_UP, bar)
    for name in ("forward", "backward"):
        times = row[f"{name}_ms"]
        print(f"{name}: median {times['p50']:.1f} ms, p95 {times['p95']:.1f} ms")
    print(f"pairs: {row['pairs']:,}")
    write_json(json_file, {**row, "machine": machine()})
