"""Measured settings go through their file, and are used only for what they were measured for."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest

from compose.base.errors import UserError
from compose.eye.display import Display
from hybrid.base import identity
from hybrid.base.cache_folder import scene_folder
from hybrid.evaluation import measured_settings as module
from hybrid.evaluation.measured_settings import MeasuredSettings, MeasuredStore, front_of
from hybrid.render.frame_settings import FrameSettings
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
