"""A lamp that is dimmed: the error of a cache that follows it, in closed form, and the lamp afterwards."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from hybrid.bench import relighting
from hybrid.bench.bias import PASS
from hybrid.bench.relighting import bench_relighting
from hybrid.frame import irradiance
from pathtrace.cache.cache import IrradianceCache
from pathtrace.cache.cells import Grid
from pathtrace.fill.fill import fill_cache
from pathtrace.fill.relight import PARTS
from pathtrace.scene.scene import Scene, load_scene
from tests import small

STATES = ["stale", "1 updates", "4 updates", "8 updates", "12 updates", "fresh 1", "fresh 2", "fresh 3"]


class Clock:
    """Stands for the module `time`: the first update takes very long, and each 17th longer."""

    def __init__(self) -> None:
        self._now, self._readings = 0.0, 0

    def perf_counter(self) -> float:
        update, ends = divmod(self._readings, 2)
        if ends:
            self._now += 1000.0 if update == 0 else 0.008 if update % 11 == 0 else 0.002
        self._readings += 1
        return self._now


@pytest.fixture(scope="module")
def furnace(backend) -> tuple[Scene, IrradianceCache]:
    """A sphere whose wall emits 0.5 and reflects 0.5, and its cache."""
    scene = load_scene(small.furnace(0.5))
    return scene, fill_cache(scene, [scene.camera], points=1 << 12)


@pytest.fixture(scope="module")
def run(furnace) -> tuple[dict[str, Any], list[tuple[int, int]], list[float]]:
    """What the bench finds; the progress that it reports, and the wall's emission meanwhile."""
    scene, cache = furnace
    reported, emission = [], []

    def progress(done: int, total: int) -> None:
        reported.append((done, total))
        emission.append(emitted(scene))

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(relighting, "time", Clock())
        found = bench_relighting(scene, scene.camera, cache, 2 * PASS - 1, progress)
    return found, reported, emission


def emitted(scene: Scene) -> float:
    """By the wall of the furnace."""
    return float(mi.traverse(scene.mitsuba.emitters()[0])["radiance.value"].x[0])


def test_a_stale_cache_is_wrong_by_the_light_that_paths_took_from_it(run):
    """The light of the first two segments is new.

    With the wall's emission halved to 1/4, they bring 1/4 + 1/8, and the cache 1/4 (all but 2^-6 of it)
    instead of 1/8: with all paths in the cache, the image is brighter by a quarter.
    """
    found, _, _ = run
    (stale,) = (row["squared_bias"] for row in found["rows"] if row["cache"] == "stale")
    expected = ((3 / 8 + (1 - 2**-6) / 4) / (1 / 2 * (1 - 2**-8)) - 1) ** 2
    # Some paths go on, where no cell is known.
    assert 0.9 * expected < stale < 1.005 * expected


def test_a_cache_that_follows_is_as_good_as_one_filled_anew(run):
    found, _, _ = run
    assert [row["cache"] for row in found["rows"]] == STATES
    bias = {row["cache"]: row["squared_bias"] for row in found["rows"]}
    # Half a percent.
    assert all(0 < bias[state] < 0.005**2 for state in STATES[1:])
    # Each is a cache of its own.
    assert len(set(bias.values())) == len(STATES)


def test_the_first_update_is_not_timed(run):
    """Of the 11 others, one takes longer: the percentile lies halfway from the others to it."""
    found, _, _ = run
    assert PARTS == 12
    assert found["update_ms"] == pytest.approx({"p50": 2, "p95": 2 + 0.5 * 6})


def test_it_tells_how_many_samples_are_done_while_the_lamp_is_dimmed(run, furnace):
    _, reported, emission = run
    # An unbiased image and one for each state, in two passes.
    passes = 2 * (1 + len(STATES))
    assert reported == [(number * PASS, passes * PASS) for number in range(1, passes + 1)]
    assert emission == [0.25] * passes
    assert emitted(furnace[0]) == 0.5


def colour(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": value}


def picture(height: int, width: int) -> mi.Bitmap:
    return mi.Bitmap(small.rng().uniform(0.5, 1, (height, width, 3)).astype(np.float32))


def lights() -> dict[str, dict[str, Any]]:
    """One of each kind that a scene may have at once, but for the sky."""
    return {
        "spot": {"type": "spot", "intensity": colour(2.0)},
        "sun": {"type": "directional", "irradiance": colour(3.0)},
        "point": {"type": "point", "intensity": colour(4.0)},
    }


def textured() -> dict[str, Any]:
    """A lamp that shows a picture, which no single number scales."""
    radiance = {"type": "bitmap", "raw": True, "bitmap": picture(2, 2)}
    return {"type": "rectangle", "emitter": {"type": "area", "radiance": radiance}}


SKIES = {
    "even": lambda: {"type": "constant", "radiance": colour(1.5)},
    "picture": lambda: {"type": "envmap", "bitmap": picture(4, 8)},
}


def strengths(scene: Scene) -> dict[str, np.ndarray]:
    """All parameters of all lights."""
    return {
        f"{number} {key}": np.array(value)
        for number, light in enumerate(scene.mitsuba.emitters())
        for key, value in mi.traverse(light)
        if "to_" not in key
    }


def changed(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> list[str]:
    assert one.keys() == other.keys()
    return [key for key in one if not np.array_equal(one[key], other[key])]


class StoppedError(Exception):
    """Ends a bench where it begins."""


def favouring(cache: IrradianceCache, number: int, count: int) -> IrradianceCache:
    """A cache whose strongest light, over all places, is that of a number; another one is in some place."""
    chances = np.full((2, count), 0.1, dtype=np.float32)
    chances[0, number - 1] = chances[1, number] = 1.1 - 0.1 * count
    return replace(cache, lights=replace(cache.lights, chances=chances))


@pytest.mark.parametrize("sky", SKIES)
def test_the_strongest_light_alone_is_halved_and_put_back_even_if_the_bench_is_stopped(
    sky, furnace, monkeypatch
):
    scene = load_scene({**small.furnace(), **lights(), "sky": SKIES[sky]()})
    before, count, halved = strengths(scene), len(scene.mitsuba.emitters()), []
    assert count == 5

    def stop(*arguments: Any) -> None:
        now = strengths(scene)
        (key,) = changed(before, now)
        np.testing.assert_allclose(now[key], 0.5 * before[key])
        halved.append(key)
        raise StoppedError

    monkeypatch.setattr(relighting, "converged", stop)
    for number in range(count):
        with pytest.raises(StoppedError):
            bench_relighting(
                scene, scene.camera, favouring(furnace[1], number, count), 1, lambda done, total: None
            )
        assert changed(before, strengths(scene)) == []
    assert [int(key.split()[0]) for key in halved] == list(range(count))


def untouched(scene: Scene, cache: IrradianceCache) -> dict[str, Any]:
    """What the bench finds where it makes no image."""
    before = strengths(scene)
    image_made = lambda done, total: pytest.fail("an image was made")  # noqa: E731
    found = bench_relighting(scene, scene.camera, cache, 1, image_made)
    assert changed(before, strengths(scene)) == []
    return found


def test_a_light_that_nothing_scales_is_not_measured(furnace):
    scene = load_scene({"type": "scene", "sensor": small.sensor(), "lamp": textured()})
    assert untouched(scene, favouring(furnace[1], 0, 1)) == {"rows": [], "update_ms": {}}


def test_a_cache_without_cells_is_not_measured(furnace):
    nothing = IrradianceCache.empty(Grid(np.zeros(3, dtype=np.float32), 1.0), 1)
    assert untouched(furnace[0], nothing) == {"rows": [], "update_ms": {}}


def test_a_cache_follows_a_dimmed_lamp_of_a_room(backend, monkeypatch):
    # As many points as in use.
    monkeypatch.setattr(irradiance, "fill_cache", fill_cache)
    scene = load_scene("room")
    camera, cache = scene.camera.resized(64, 64), irradiance.filled_cache(scene)
    found = bench_relighting(scene, camera, cache, 128, lambda done, total: None)
    bias = {row["cache"]: row["squared_bias"] for row in found["rows"]}
    assert list(bias) == STATES
    assert bias["1 updates"] < 0.1 * bias["stale"]
    assert bias["12 updates"] < 2 * max(bias[f"fresh {n}"] for n in (1, 2, 3))
    assert found["update_ms"]["p50"] > 0


def test_a_lamp_that_was_dimmed_is_put_back(backend):
    scene = load_scene(small.corner())
    strength = lambda: [value for key, value in mi.traverse(scene.mitsuba) if key.endswith("radiance.value")]  # noqa: E731
    before = np.array(strength()[0])
    cache = fill_cache(scene, [scene.camera], points=4096)
    found = bench_relighting(scene, scene.camera, cache, 16, lambda done, total: None)
    assert len(found["rows"]) == 8
    np.testing.assert_array_equal(strength()[0], before)
