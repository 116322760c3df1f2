"""Efficiency and bias of integrators."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.bench.integrator import BLOCK, bench_integrator, relative_errors
from pathtrace.scene.scene import load_scene
from tests import small


def test_errors_are_those_of_mean_and_blocks():
    truth = np.ones((2 * BLOCK + 5, 3 * BLOCK, 3))
    image = truth.copy()
    image[:BLOCK, BLOCK : 2 * BLOCK] *= 1.5
    image[-5:, :BLOCK] *= 0.25
    found = relative_errors(image, truth)
    area = (0.5 * BLOCK**2 - 0.75 * 5 * BLOCK) / truth[..., 0].size
    assert found["mean"] == pytest.approx(area)
    assert found["worst_block"] == pytest.approx(0.75)
    assert found["p95_block"] < 0.75


def test_black_blocks_have_no_relative_error():
    truth = np.zeros((BLOCK, 2 * BLOCK, 3))
    assert relative_errors(truth, truth) == {"mean": 0.0, "worst_block": 0.0, "p95_block": 0.0}
    truth[:, :BLOCK] = 2
    image = truth.copy()
    image[:, BLOCK:] = 1
    assert relative_errors(image, truth)["worst_block"] == 0


def test_a_room_is_traced_with_less_noise_and_little_bias(backend):
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
    assert steps[-1][0] == steps[-1][1]


def test_a_black_view_has_no_error(backend):
    scene = load_scene({**small.corner(), "lamp": {"type": "point", "intensity": 0.0, "position": [0, 0, 0]}})
    found = bench_integrator(scene, scene.camera, 16, 3, lambda done, total: None)
    assert all(row["squared_error"] == 0 for row in found["rows"])
    assert all(row["mean"] == 0 for row in found["bias"])
