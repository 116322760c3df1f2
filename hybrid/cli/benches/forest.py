"""`hybrid bench forest`."""

from __future__ import annotations

from typing import Annotated

import typer

from hybrid.cli.options import MOST_GAUSSIANS, Backend, Json, Seed, select, write_json


def forest(
    nodes: Annotated[
        int, typer.Option(help="Gaussians of the finest layer.", min=1, max=MOST_GAUSSIANS)
    ] = 1_000_000,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Build a forest over random Gaussians, load it again, and measure the memory of rendering."""
    select(backend)
    from hybrid.bench.forest import bench_forest
    from hybrid.runtime.device import device_arrays
    from hybrid.runtime.machine import machine

    row = bench_forest(nodes, seed, device_arrays().backend)
    print(f"layers of {', '.join(f'{count:,}' for count in row['layers'])} nodes")
    print(f"built in {row['build_s']:.1f} s, loaded in {row['load_s']:.1f} s")
    print(f"peak memory of loading and rendering: {row['peak_bytes'] / 1e9:.2f} GB")
    write_json(json_file, {**row, "machine": machine()})
