"""What the first frame needs is loaded or trained, with its progress reported."""

from __future__ import annotations

import pytest

from compose.base.errors import UserError
from hybrid.base.cache_folder import store_forest
from hybrid.preparation.scene_plan import as_planned
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from hybrid.window import frame_source as prepare
from hybrid.window.frame_source import prepared
from hybrid.window.learning import ShownScene
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest

pytestmark = pytest.mark.usefixtures("backend", "own_home")


RAW = FrameSettings(fovea="raw")


def unsaid(line: str) -> None:
    pytest.fail(f"{line} is said")


def silent(done: int, total: int, label: str) -> None:
    if not label.startswith("plan for"):
        pytest.fail(f"{label} is reported")


def test_a_scene_and_its_forest_become_a_source(made):
    source = prepared(ShownScene("cornell"), made / "box.forest", False, RAW, silent, unsaid)
    assert source.ready().name == "cornell"
    assert source.layers == 2


def test_the_backend_is_selected_before_the_scene_is_loaded(made, monkeypatch):
    done: list[str] = []
    load = prepare.load_scene
    monkeypatch.setattr(prepare, "select_backend", done.append)
    monkeypatch.setattr(prepare, "load_scene", lambda name, **_: done.append(name) or load(name))
    prepared(ShownScene("cornell", backend="llvm"), made / "box.forest", False, RAW, silent, unsaid)
    assert done == ["llvm", "cornell"]


def test_the_newest_forest_of_the_scene_is_used(made):
    # Which stores its plan, as a preparation does.
    as_planned(load_scene("cornell"))
    store_forest(load_forest(made / "box.forest"), "box")
    source = prepared(ShownScene("cornell"), None, False, RAW, silent, unsaid)
    assert source.renderer.periphery.forest.digest() == load_forest(made / "box.forest").digest()


def test_a_missing_scene_or_forest_is_named(tmp_path):
    with pytest.raises(UserError, match="no-such-scene"):
        prepared(ShownScene("no-such-scene"), None, True, RAW, silent, unsaid)
    with pytest.raises(UserError, match=r"missing\.forest"):
        prepared(ShownScene("cornell"), tmp_path / "missing.forest", True, RAW, silent, unsaid)


def test_a_forest_of_another_scene_is_refused(made):
    with pytest.raises(UserError, match="belongs to scene cornell"):
        prepared(ShownScene("room"), made / "box.forest", False, RAW, silent, unsaid)


def test_filling_is_reported(made, monkeypatch):
    def fills(scene, bars):
        with bars("irradiance (steps)") as bar:
            bar(1, 4)

    reported: list[tuple[int, int, str]] = []
    monkeypatch.setattr(prepare, "cache_for", fills)
    prepared(
        ShownScene("cornell"),
        made / "box.forest",
        False,
        INTERACTIVE,
        lambda *step: reported.append(step),
        unsaid,
    )
    assert [step for step in reported if not step[2].startswith("plan for")] == [(1, 4, "irradiance (steps)")]


def test_a_raw_fovea_needs_no_irradiance(made, monkeypatch):
    monkeypatch.setattr(prepare, "cache_for", lambda scene, bars: pytest.fail("the cache is filled"))
    prepared(ShownScene("cornell"), made / "box.forest", False, RAW, silent, unsaid)
