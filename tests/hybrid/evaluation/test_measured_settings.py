"""Measured settings: stored, on the front, and chosen."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import permutations
from types import SimpleNamespace

import pytest

from compose.base.errors import UserError
from compose.eye.display import Display
from hybrid.base import identity
from hybrid.base.cache_folder import scene_folder
from hybrid.evaluation import measured_settings as module
from hybrid.evaluation.measured_settings import (
    MeasuredSettings,
    MeasuredStore,
    chosen,
    front_of,
    pareto_front,
)
from hybrid.render.frame_settings import FrameSettings
from tests import small
from tests.hybrid.forests import white_dot

pytestmark = pytest.mark.usefixtures("backend", "own_home")
SCENE = SimpleNamespace(name="room", hash="ab" * 32, max_depth=8, roulette_depth=5)
BASE = FrameSettings(acuity_model="fov-gs", display=Display(800, 600, 50))
# Every quantity that is varied, away from its default.
MEASURED = [
    MeasuredSettings(replace(BASE, fovea="raw", spp=1, fov_a=30, fov_b=10), 12.5, 7.25),
    MeasuredSettings(replace(BASE, layers=(1, 2), rate=2, scale=0.5), 20.0, 8.0),
]


@pytest.fixture(scope="module")
def forest():
    return white_dot((0, 0, 1))


@pytest.fixture
def store(forest) -> MeasuredStore:
    return MeasuredStore("trade", SCENE, forest, (64, 48), BASE)


def test_what_is_stored_is_loaded_again(store):
    assert store.load() is None
    store.save("jod", MEASURED)
    assert store.load() == ("jod", MEASURED)
    store.save("ssim", MEASURED[:1])
    assert store.load() == ("ssim", MEASURED[:1])


def test_the_file_lies_in_the_scenes_folder_and_is_the_only_one(store):
    store.save("jod", MEASURED)
    assert store.file.parent == scene_folder("room", "ab" * 32)
    assert store.file.name.startswith("measured-trade-64x48-")
    assert list(store.file.parent.iterdir()) == [store.file]


def test_gaze_and_camera_are_those_of_the_use_not_of_the_measurement(forest, store):
    store.save("jod", MEASURED)
    other = MeasuredStore("trade", SCENE, forest, (64, 48), replace(BASE, gaze=(0.1, 0.2)))
    assert other.file == store.file
    _, found = other.load()
    assert {one.settings.gaze.x for one in found} == {0.1}


@pytest.mark.parametrize(
    "changed",
    [
        {"kind": "window"},
        {"scene": SimpleNamespace(name="room", hash="ab" * 32, max_depth=9, roulette_depth=5)},
        {"forest": white_dot((0, 0, 2))},
        {"size": (48, 64)},
        {"base": replace(BASE, acuity_model="none")},
        {"base": replace(BASE, integrator="cached")},
        {"base": replace(BASE, display=Display(800, 600, 50, 100))},
    ],
)
def test_measurements_of_something_else_are_not_used(store, forest, changed):
    store.save("jod", MEASURED)
    given = {"kind": "trade", "scene": SCENE, "forest": forest, "size": (64, 48), "base": BASE}
    other = MeasuredStore(**(given | changed))
    assert other.load() is None
    # Both are kept side by side.
    other.save("jod", MEASURED[:1])
    assert len(store.load()[1]) == 2


def test_measurements_of_another_machine_are_not_used(store, forest, monkeypatch):
    store.save("jod", MEASURED)
    monkeypatch.setattr(identity, "machine", lambda: {"cpu": "another one"})
    assert MeasuredStore("trade", SCENE, forest, (64, 48), BASE).load() is None


def test_a_file_that_was_moved_from_another_machine_is_refused(store):
    store.save("jod", MEASURED)
    content = json.loads(store.file.read_text())
    content["identity"]["machine"]["cpu"] = "another one"
    store.file.write_text(json.dumps(content))
    message = f"^{store.file}: was measured for other inputs \\(machine\\); delete it to measure again$"
    with pytest.raises(UserError, match=message):
        store.load()


def damaged(**changes: object) -> str:
    """A store's content with one row, with changes in the row."""
    row = {"fovea": "raw", "spp": 1, "fov_a": 30, "fov_b": 10, "layers": None, "rate": 0, "scale": 1}
    row |= {"milliseconds": 1.0, "quality": 1.0}
    kept = {name: value for name, value in (row | changes).items() if value != "left out"}
    return json.dumps({"identity": {}, "metric": "jod", "rows": [kept]})


@pytest.mark.parametrize(
    "content",
    [
        "",
        '{"identity": ',
        "[]",
        "{}",
        '{"identity": 3, "metric": "jod", "rows": []}',
        '{"identity": {}, "rows": []}',
        '{"identity": {}, "metric": "jod", "rows": 3}',
        damaged(spp="left out"),
        damaged(quality="left out"),
        damaged(milliseconds="fast"),
        damaged(spp=0),
        damaged(fovea="sharp"),
        damaged(layers=3),
    ],
)
def test_a_damaged_file_is_named(store, content):
    store.file.parent.mkdir(parents=True)
    store.file.write_text(content)
    with pytest.raises(UserError, match=f"^{store.file}: is damaged .*; delete it to measure again$"):
        store.load()


def test_a_folder_that_cannot_be_written_is_named(store):
    store.file.parent.parent.mkdir(parents=True, exist_ok=True)
    store.file.parent.write_text("")
    with pytest.raises(UserError, match=f"^{store.file}: cannot be written"):
        store.save("jod", MEASURED)


def test_an_interrupted_save_leaves_what_was_stored_before(store, monkeypatch):
    store.save("jod", MEASURED)

    def interrupted(path, text):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "write_text", interrupted)
    with pytest.raises(KeyboardInterrupt):
        store.save("jod", MEASURED[:1])
    assert store.load() == ("jod", MEASURED)


def test_the_front_is_that_of_time_and_quality():
    rows = [(20.0, 8.0), (10.0, 7.0), (15.0, 6.0), (20.0, 7.5)]
    measured = [MeasuredSettings(BASE, *row) for row in rows]
    assert front_of(measured) == [measured[1], measured[0]]


def front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return pareto_front(points, lambda point: point)


def test_what_is_slower_and_worse_is_left_out():
    #           fast, poor  slower, better  slower, worse  slowest, best
    points = [(50.0, 8.0), (100.0, 9.0), (120.0, 8.9), (400.0, 9.6)]
    for shuffled in permutations(points):
        assert front(list(shuffled)) == [(50, 8), (100, 9), (400, 9.6)]


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([], []),
        ([(1, 1)], [(1, 1)]),
        # Equally good but slower; equally fast but worse.
        ([(2, 5), (1, 5)], [(1, 5)]),
        ([(1, 4), (1, 5)], [(1, 5)]),
        ([(1, 5), (2, 4), (3, 3)], [(1, 5)]),
        ([(1, -3), (2, -2)], [(1, -3), (2, -2)]),
    ],
)
def test_ties_and_ends(points, expected):
    assert front(points) == expected


def test_of_equal_items_the_first_one_stays():
    items = [("a", 1, 5), ("b", 1, 5)]
    assert pareto_front(items, lambda item: item[1:]) == [("a", 1, 5)]


def test_every_item_that_is_left_out_is_beaten_and_none_of_the_front_is():
    points = [(float(t), float(q)) for t, q in small.rng().integers(0, 20, (200, 2))]
    found = front(points)

    def beaten(point: tuple[float, float]) -> bool:
        return any(t <= point[0] and q >= point[1] and (t, q) != point for t, q in points)

    assert not any(beaten(point) for point in found)
    assert all(beaten(point) for point in points if point not in found)
    times, qualities = zip(*found, strict=True)
    assert list(times) == sorted(set(times))
    assert list(qualities) == sorted(set(qualities))


def measured(*rows: tuple[float, float]) -> list[MeasuredSettings]:
    """Settings by time and quality; each differs from the others."""
    return [MeasuredSettings(FrameSettings(spp=1 + i), *row) for i, row in enumerate(rows)]


CHOICE_MEASURED = measured((50, 8.0), (100, 9.0), (120, 8.9), (400, 9.6))


@pytest.mark.parametrize(
    ("milliseconds", "jod", "expected"),
    [
        (130, None, 100),
        (100, None, 100),
        (99.9, None, 50),
        (1e6, None, 400),
        (None, 8.5, 100),
        (None, 9.0, 100),
        (None, 9.01, 400),
        (None, -1, 50),
        (500, 9.5, 400),
        (130, 8.95, 100),
    ],
)
def test_the_best_in_a_time_and_the_fastest_of_a_quality(milliseconds, jod, expected):
    assert chosen("jod", CHOICE_MEASURED, milliseconds, jod).milliseconds == expected
    assert chosen("jod", CHOICE_MEASURED[::-1], milliseconds, jod).milliseconds == expected


def test_without_a_target_the_best_settings_are_chosen():
    assert chosen("jod", CHOICE_MEASURED, None, None) is CHOICE_MEASURED[3]


def test_of_equally_good_settings_the_fastest_are_chosen():
    equal = measured((120, 9.0), (100, 9.0), (110, 9.0))
    for order in (equal, equal[::-1]):
        assert chosen("jod", order, 200, None).milliseconds == 100


def test_a_time_that_nothing_meets_is_refused_with_the_least_time():
    with pytest.raises(UserError, match=r"^target of 40 ms: the fastest settings take 50 ms$"):
        chosen("jod", CHOICE_MEASURED, 40, None)
    with pytest.raises(UserError, match=r"^target of 40 ms: the fastest settings take 50 ms$"):
        chosen("jod", CHOICE_MEASURED, 40, 8.0)


def test_a_quality_that_nothing_reaches_is_refused_with_the_best_one():
    with pytest.raises(UserError, match=r"^target of 9.5 JOD: the best settings in 130 ms reach 9.00$"):
        chosen("jod", CHOICE_MEASURED, 130, 9.5)
    with pytest.raises(UserError, match=r"^target of 9.7 JOD: the best settings reach 9.60$"):
        chosen("jod", CHOICE_MEASURED, None, 9.7)


def test_a_quality_in_jod_is_not_compared_with_another_metric():
    similarity = measured((50, 0.9))
    assert chosen("ssim", similarity, 60, None).quality == 0.9
    message = r"target of 0.5 JOD: quality was measured in SSIM; .*pip install.* hybrid sweep --over trade$"
    with pytest.raises(UserError, match=message):
        chosen("ssim", similarity, None, 0.5)
