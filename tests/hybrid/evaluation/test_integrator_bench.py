"""The bench of integrators: efficiency, bias, and the time of a look-up."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain, repeat
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from compose.camera.camera import Camera
from hybrid.evaluation import integrator_bench as look_up
from hybrid.evaluation.integrator_bench import (
    BLOCK,
    bench_integrator,
    block_errors,
    look_up_ns,
    relative_errors,
)
from hybrid.render import irradiance
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import Scene, load_scene
from tests import small


def test_a_room_is_traced_with_less_noise_and_little_bias(backend, monkeypatch):
    # As many points as in use.
    monkeypatch.setattr(irradiance, "fill_cache", fill_cache)
    scene = load_scene("room")
    steps = []
    found = bench_integrator(
        scene, scene.camera.resized(48, 48), 256, 3, lambda done, total: steps.append((done, total))
    )
    pairs = list(zip(found["rows"][::2], found["rows"][1::2], strict=True))
    for (path, cached), spp in zip(pairs, (1, 4, 64, 256), strict=True):
        for row, integrator in ((path, "path"), (cached, "cached")):
            assert (row["integrator"], row["spp"]) == (integrator, spp)
    # What remains of few pixels' errors without those of the reference is not known at 256 samples.
    for path, cached in pairs[:3]:
        assert path["efficiency"] == pytest.approx(1)
        work = [row["squared_error"] * row["ms"]["p50"] for row in (path, cached)]
        assert cached["efficiency"] == pytest.approx(work[0] / work[1])
        assert 0 < cached["squared_error"] < 0.7 * path["squared_error"]
    # Without that of the reference, the error of unbiased frames is that of their samples.
    assert pairs[2][0]["squared_error"] == pytest.approx(pairs[1][0]["squared_error"] / 16, rel=0.4)
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


def test_errors_of_blocks_have_signs():
    truth = np.ones((BLOCK, 2 * BLOCK, 3))
    image = truth.copy()
    image[:, :BLOCK] = 0.5
    np.testing.assert_allclose(block_errors(image, truth), [-0.5, 0])
    assert block_errors(image, 0 * truth) == [0]


SIDE = 16


class Clock:
    """Stands for the module `time`; of two readings, the second comes as much later as it is told."""

    def __init__(self, seconds: Iterable[float], events: list[str] | None = None):
        self._seconds, self._now, self._runs = iter(seconds), 0.0, False
        self._events = [] if events is None else events

    def perf_counter(self) -> float:
        if self._runs:
            self._now += next(self._seconds)
        self._runs = not self._runs
        self._events.append("start" if self._runs else "stop")
        return self._now


def nothing_known() -> IrradianceCache:
    return IrradianceCache.empty(1)


@pytest.fixture(scope="module")
def furnace(backend) -> tuple[Scene, Camera, IrradianceCache]:
    """A sphere of radius 3 around a camera, and its cache."""
    scene = load_scene(small.furnace())
    cache = fill_cache(scene, [scene.camera], points=1 << 12)
    return scene, scene.camera.resized(SIDE, SIDE), cache


@pytest.fixture(scope="module")
def board(backend) -> tuple[Scene, Camera, IrradianceCache]:
    """A board before nothing."""
    parts = small.corner()
    scene = load_scene({name: part for name, part in parts.items() if name not in ("back", "ball")})
    return scene, scene.camera.resized(SIDE, SIDE), nothing_known()


def seen(scene: Scene, camera: Camera) -> int:
    """Pixels in whose middle something is visible."""
    origin, direction = camera.position.astype(np.float32), camera.rays(camera.pixel_centres())
    ray = mi.Ray3f(mi.Point3f(*origin.tolist()), mi.Vector3f(direction.astype(np.float32).T))
    return int(dr.count(scene.mitsuba.ray_intersect(ray).is_valid())[0])


def test_a_look_up_takes_a_finite_time(furnace):
    """Or none, where so few take less than noise."""
    assert 0 <= look_up_ns(*furnace) < np.inf


@pytest.mark.parametrize("view", ["furnace", "board"])
def test_it_is_the_difference_of_two_kernels_by_points_and_look_ups(view, request, monkeypatch):
    """The first of each kind compiles; and a single slow one does not count."""
    scene, camera, cache = request.getfixturevalue(view)
    points = seen(scene, camera)
    assert points == SIDE**2 if view == "furnace" else 0 < points < SIDE**2
    seconds = [(50.0, 900.0), (1.0, 5.0), (2.0, 70.0), (30.0, 4.5)]
    monkeypatch.setattr(look_up, "time", Clock(chain.from_iterable(seconds)))
    monkeypatch.setattr(look_up, "_REPEATS", 3)
    monkeypatch.setattr(look_up, "_LOOK_UPS", 4)
    assert look_up_ns(scene, camera, cache) == pytest.approx((5 - 2) * 1e9 / (4 * points))


def test_it_is_never_negative(furnace, monkeypatch):
    monkeypatch.setattr(look_up, "time", Clock(chain.from_iterable(repeat((3.0, 2.0)))))
    assert look_up_ns(*furnace) == 0


def test_a_view_of_nothing_has_a_time(board, monkeypatch):
    scene, camera, cache = board
    away = Camera(
        np.diag([-1.0, 1, -1, 1]) @ camera.world_to_camera, SIDE, SIDE, *[SIDE] * 2, *[SIDE / 2] * 2
    )
    assert seen(scene, away) == 0
    monkeypatch.setattr(look_up, "time", Clock(chain.from_iterable(repeat((1.0, 3.0)))))
    monkeypatch.setattr(look_up, "_LOOK_UPS", 4)
    # As if there were one point.
    assert look_up_ns(scene, away, cache) == pytest.approx(2e9 / 4)


def watched(found: list[tuple[Any, ...]], events: list[str]) -> Callable[..., Any]:
    """The look-up, which keeps what it was asked and what it answered."""
    answer = look_up.look_up

    def ask(known: Any, *asked: Any) -> Any:
        result = answer(known, *asked)
        events.append("look-up")
        dr.eval(asked, result)
        found.append((*asked, *result))
        return result

    return ask


def test_only_the_second_kernel_looks_up_what_is_seen_from_inside(furnace, monkeypatch):
    scene, camera, cache = furnace
    found: list[tuple[Any, ...]] = []
    events: list[str] = []
    monkeypatch.setattr(look_up, "look_up", watched(found, events))
    monkeypatch.setattr(look_up, "time", Clock(repeat(1.0), events))
    monkeypatch.setattr(look_up, "_LOOK_UPS", 3)
    monkeypatch.setattr(look_up, "_REPEATS", 2)
    # Nothing is recorded, so that what is looked up can be read.
    with (
        dr.scoped_set_flag(dr.JitFlag.KernelFreezing, False),
        dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False),
    ):
        look_up_ns(scene, camera, cache)
    assert events == ["start", "stop", "start", *["look-up"] * 3, "stop"] * 3
    jitters = []
    for position, normal, area, segments, jitter, active, known, answer in found:
        place, side = position.numpy().T, normal.numpy().T
        np.testing.assert_allclose(np.linalg.norm(place, axis=1), 3, rtol=1e-4)
        np.testing.assert_allclose(side, -place / 3, atol=1e-4)
        assert len(place) == SIDE**2
        assert active.numpy().all()
        # Cells of all sizes and all light may answer, and nearly all points are known.
        assert known.numpy().mean() > 0.9
        assert (area.numpy() == np.inf).all()
        assert (segments.numpy() >= len(cache.irradiance)).all()
        light = answer.numpy().T[known.numpy()]
        assert light.mean() == pytest.approx(np.pi, rel=0.05)
        jitters.append(jitter.numpy())
    # Each look-up has chances of its own.
    assert len(np.unique(np.concatenate(jitters, axis=1), axis=1).T) > 0.99 * 9 * SIDE**2
