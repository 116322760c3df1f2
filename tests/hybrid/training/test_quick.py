"""The forest of a scene: the given one, the newest one, or one that is made now."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace

import pytest

from compose.base.errors import UserError
from hybrid.store.cache import newest_forest, scene_folder, store_forest
from hybrid.training import quick as module
from hybrid.training.quick import QUICK_CAPTURE, QUICK_TRAINING, forest_for, make_quick_forest
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.scene.scene import Scene, load_scene
from splat.io.forest_file import save_forest
from splat.model.forest import Forest
from splat.training.trainer import TrainingSettings
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
    """Notes captures and trainings in place of doing them."""
    notes = []

    def cache_for(scene, bars):
        with bars("irradiance (steps)") as bar:
            bar(5, 6)
        return "cache"

    def capture(scene, folder, settings, progress, cache):
        assert cache == "cache"
        progress(1, 2)
        notes.append(("capture", folder, settings))
        return "frames"

    def train(frames, path, settings, progress):
        progress(3, 4)
        notes.append(("train", path, settings, frames))
        return forest

    monkeypatch.setattr(module, "cache_for", cache_for)
    monkeypatch.setattr(module, "capture", capture)
    monkeypatch.setattr(module, "train", train)
    return notes


def test_a_given_forest_is_loaded(scene, forest, made, tmp_path):
    store_forest(replace(forest, trained_focal=60.0), "newest")
    save_forest(tmp_path / "given", forest)
    assert forest_for(scene, tmp_path / "given").trained_focal == 50
    assert not made


def test_a_given_forest_of_another_scene_is_refused(scene, forest, made, tmp_path):
    save_forest(tmp_path / "given", replace(forest, scene_hash="ab" * 32))
    with pytest.raises(UserError, match=f"^{tmp_path / 'given'} belongs to scene"):
        forest_for(scene, tmp_path / "given")
    with pytest.raises(UserError, match="none"):
        forest_for(scene, tmp_path / "none")
    assert not made


def test_without_one_the_newest_forest_is_loaded(scene, forest, made):
    store_forest(replace(forest, trained_focal=60.0), "newest")
    assert forest_for(scene, None).trained_focal == 60
    assert not made


def test_without_any_forest_one_is_made_and_stored(scene, forest, made, capsys):
    assert forest_for(scene, None) is forest
    assert f"No forest for scene {scene.name} yet" in capsys.readouterr().err
    folder = scene_folder(scene.name, scene.hash)
    assert [note[:2] for note in made] == [
        ("capture", folder / "frames-0"),
        ("train", folder / "quick-0.safetensors"),
    ]
    assert newest_forest(scene) == folder / "forests" / "quick-0.safetensors"
    made.clear()
    forest_for(scene, None)
    assert not made


def test_the_bars_of_the_caller_are_used(scene, made):
    titles = []

    @contextmanager
    def noting(title):
        titles.append(title)
        yield lambda done, total: None

    forest_for(scene, None, noting)
    assert titles == ["irradiance (steps)", "capture (samples)", "train (steps)"]


def test_quick_settings_take_minutes():
    """40 x 16 + 4 x 64 samples per pixel of 256 x 256, and 900 steps."""
    assert CaptureSettings(40, 4, 256, 256, 16, 64) == QUICK_CAPTURE
    assert TrainingSettings(900, 30_000, 4, 2) == QUICK_TRAINING


def test_quick_settings_have_the_seed_that_was_asked_for(scene, forest, made, tmp_path):
    bars = []

    @contextmanager
    def noting(title):
        yield lambda done, total: bars.append((title, done, total))

    found = make_quick_forest(scene, tmp_path, 7, noting)
    assert found.forest is forest
    assert found.frames == "frames"
    assert {*found.seconds} == {"capture", "train"}
    assert min(found.seconds.values()) >= 0
    capture, train = made
    assert capture == ("capture", tmp_path / "frames-7", replace(QUICK_CAPTURE, seed=7))
    assert train == ("train", tmp_path / "quick-7.safetensors", replace(QUICK_TRAINING, seed=7), "frames")
    assert bars == [("irradiance (steps)", 5, 6), ("capture (samples)", 1, 2), ("train (steps)", 3, 4)]
    assert newest_forest(scene).name == "quick-7.safetensors"
