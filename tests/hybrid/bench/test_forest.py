"""Building and loading a forest of random Gaussians."""

from __future__ import annotations

from hybrid.bench.forest import bench_forest


def test_the_finest_layer_has_as_many_nodes_as_asked_for(arrays):
    row = bench_forest(500, 0, arrays.backend)
    assert row["finest"] == row["layers"][-1] == 500
    assert row["layers"] == sorted(row["layers"])
    assert row["peak_bytes"] > 10_000_000
    assert row["nodes_drawn"] > 0
