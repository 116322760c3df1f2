"""Efficiency and bias of integrators."""

from __future__ import annotations

import pytest

from hybrid.evaluation.integrator_bench import bench_integrator
from hybrid.render import irradiance
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import load_scene
from tests import small


def test_a_room_is_traced_with_less_noise_and_little_bias(backend, monkeypatch):
    # As many points as in use.
    monkeypatch.setattr(irradiance, "fill_cache", fill_cache)
    scene = load_scene("room")
    steps = []
    found = bench_integrator(
        scene, scene.camera.resized(64, 64), 128, 3, lambda done, total: steps.append((done, total))
    )
    assert [(row["integrator"], row["spp"]) for row in found["rows"]] == [
        *(("path", 1), ("cached", 1)),
        *(("path", 4), ("cached", 4)),
    ]
    for path, cached in (found["rows"][:2], found["rows"][2:]):
        assert path["efficiency"] == pytest.approx(1)
        work = [row["squared_error"] * row["ms"]["p50"] for row in (path, cached)]
        assert cached["efficiency"] == pytest.approx(work[0] / work[1])
        assert cached["squared_error"] < 0.7 * path["squared_error"]
    for row in found["bias"]:
        assert abs(row["mean"]) < 0.02
        assert row["p95_block"] <= row["worst_block"] < 0.05
    assert found["cache"]["cells"] > 100
    assert found["cache"]["bytes"] < 200 << 20
    assert found["cache"]["transfer_bytes"] < 200 << 20
    assert 0 < found["cache"]["look_up_ns"] < 1e5
    assert steps[-1][0] == steps[-1][1]


def test_a_black_view_has_no_error(backend):
    scene = load_scene({**small.corner(), "lamp": {"type": "point", "intensity": 0.0, "position": [0, 0, 0]}})
    found = bench_integrator(scene, scene.camera, 16, 3, lambda done, total: None)
    assert all(row["squared_error"] == 0 for row in found["rows"])
    assert all(row["mean"] == 0 for row in found["bias"])
