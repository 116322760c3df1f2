"""What the first frame needs is loaded or trained, with its progress reported."""

from __future__ import annotations

import pytest

from compose.base.errors import UserError
from hybrid.base.cache_folder import store_forest
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from hybrid.window import frame_source as prepare
from hybrid.window.frame_source import prepared
from splat.io.forest_file import load_forest

pytestmark = pytest.mark.usefixtures("backend", "own_home")


RAW = FrameSettings(fovea="raw")


def silent(done: int, total: int, label: str) -> None:
    if not label.startswith("plan for"):
        pytest.fail(f"{label} is reported")


def test_a_scene_and_its_forest_become_a_source(made):
    source = prepared("cornell", made / "box.forest", "auto", False, RAW, silent)
    assert source.ready().name == "cornell"
    assert source.layers == 2


def test_the_backend_is_selected_before_the_scene_is_loaded(made, monkeypatch):
    done: list[str] = []
    load = prepare.scene_as_stored
    monkeypatch.setattr(prepare, "select_backend", done.append)
    monkeypatch.setattr(prepare, "scene_as_stored", lambda name, **_: done.append(name) or load(name))
    prepared("cornell", made / "box.forest", "llvm", False, RAW, silent)
    assert done == ["llvm", "cornell"]


def test_the_newest_forest_of_the_scene_is_used(made):
    store_forest(load_forest(made / "box.forest"), "box")
    source = prepared("cornell", None, "auto", False, RAW, silent)
    assert source.renderer.periphery.forest.digest() == load_forest(made / "box.forest").digest()


def test_without_a_forest_and_training_it_says_what_to_do():
    with pytest.raises(UserError, match="no forest yet; run hybrid demo cornell first"):
        prepared("cornell", None, "auto", False, RAW, silent)


def test_a_missing_scene_or_forest_is_named(tmp_path):
    with pytest.raises(UserError, match="no-such-scene"):
        prepared("no-such-scene", None, "auto", True, RAW, silent)
    with pytest.raises(UserError, match=r"missing\.forest"):
        prepared("cornell", tmp_path / "missing.forest", "auto", True, RAW, silent)


def test_a_forest_of_another_scene_is_refused(made):
    with pytest.raises(UserError, match="belongs to scene cornell"):
        prepared("room", made / "box.forest", "auto", False, RAW, silent)


def test_training_and_filling_are_reported(made, monkeypatch):
    def trains(scene, given, bars):
        assert given is None
        with bars("train (steps)") as bar:
            bar(1, 5, "layer 1")
            bar(5, 5)
        return scene, load_forest(made / "box.forest")

    def fills(scene, bars):
        with bars("irradiance (steps)") as bar:
            bar(1, 4)

    monkeypatch.setattr(prepare, "with_forest", trains)
    reported: list[tuple[int, int, str]] = []
    monkeypatch.setattr(prepare, "cache_for", fills)
    prepared("cornell", None, "auto", True, INTERACTIVE, lambda *step: reported.append(step))
    steps = [(1, 5, "train (steps) layer 1"), (5, 5, "train (steps)"), (1, 4, "irradiance (steps)")]
    assert [step for step in reported if not step[2].startswith("plan for")] == steps


def test_a_raw_fovea_needs_no_irradiance(made, monkeypatch):
    monkeypatch.setattr(prepare, "cache_for", lambda scene, bars: pytest.fail("the cache is filled"))
    prepared("cornell", made / "box.forest", "auto", False, RAW, silent)
