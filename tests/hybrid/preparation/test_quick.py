"""The forest of a scene: the given one, the newest one, or one that is made now."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace

import pytest

from compose.base.errors import UserError
from hybrid.base.cache_folder import store_forest
from hybrid.preparation import preparation as module
from hybrid.preparation.preparation import Prepared, make_quick_forest, with_forest
from hybrid.preparation.stages import PreparationSettings
from pathtrace.scene.scene import Scene, load_scene
from splat.io.forest_file import save_forest
from splat.model.forest import Forest
from tests import small
from tests.hybrid.forests import white_dot

pytestmark = pytest.mark.usefixtures("own_home")


@pytest.fixture(scope="module")
def scene(backend) -> Scene:
    return load_scene(small.furnace())


@pytest.fixture
def forest(scene) -> Forest:
    return replace(white_dot((0, 0, 1)), scene_name=scene.name, scene_hash=scene.hash)


@pytest.fixture
def made(monkeypatch, forest):
    """Notes preparations in place of doing them."""
    notes = []

    def prepare(scene, settings, bars, folder=None):
        with bars("prepare") as bar:
            bar(3, 4)
        notes.append((settings, folder))
        return Prepared(forest, {})

    monkeypatch.setattr(module, "prepare", prepare)
    return notes


def test_a_given_forest_is_loaded(scene, forest, made, tmp_path):
    store_forest(replace(forest, trained_focal=60.0), "newest")
    save_forest(tmp_path / "given", forest)
    assert with_forest(scene, tmp_path / "given")[1].trained_focal == 50
    assert not made


def test_a_given_forest_of_another_scene_is_refused(scene, forest, made, tmp_path):
    save_forest(tmp_path / "given", replace(forest, scene_hash="ab" * 32))
    with pytest.raises(UserError, match=f"^{tmp_path / 'given'} belongs to scene"):
        with_forest(scene, tmp_path / "given")
    with pytest.raises(UserError, match="none"):
        with_forest(scene, tmp_path / "none")
    assert not made


def test_without_one_the_newest_forest_is_loaded(scene, forest, made):
    store_forest(replace(forest, trained_focal=60.0), "newest")
    assert with_forest(scene, None)[1].trained_focal == 60
    assert not made


def test_without_any_forest_one_is_planned_and_prepared(scene, forest, made, caplog):
    titles = []

    @contextmanager
    def noting(title):
        titles.append(title)
        yield lambda done, total, step="": None

    caplog.set_level("INFO", "hybrid")
    planned, found = with_forest(scene, None, noting)
    assert found is forest
    assert planned.hash == scene.at_depth(planned.plan["path depth"]).hash
    assert caplog.messages == [
        f"No plan for scene {scene.name} yet: looking at it first.",
        f"No forest for scene {scene.name} yet: preparing one first.",
    ]
    assert made == [(PreparationSettings(quality="draft", held_out=0), None)]
    assert titles == [f"plan for {scene.name} (parts)", "prepare"]


def test_quick_settings_have_the_seed_that_was_asked_for(scene, forest, made, monkeypatch, tmp_path):
    given = []
    monkeypatch.setattr(module, "capture", lambda *captured: given.append(captured[:3]))
    assert make_quick_forest(scene, tmp_path, 7) == (forest, None)
    assert given == [(scene, tmp_path / "prepared-7" / "judged", replace(module.JUDGED, seed=7))]
    assert made == [(PreparationSettings(quality="draft", held_out=0, seed=7), tmp_path / "prepared-7")]
