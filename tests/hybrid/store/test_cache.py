"""The cache folder: which forest of a scene is the newest."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from hybrid.store.cache import newest_forest, scene_folder
from pathtrace.scene.scene import load_scene
from tests import small

pytestmark = pytest.mark.usefixtures("backend", "own_home")


@pytest.fixture
def scene():
    return load_scene(small.furnace())


@pytest.fixture
def folder(scene):
    """Two finished forests, the older one named last."""
    folder = scene_folder(scene.name, scene.hash) / "forests"
    folder.mkdir(parents=True)
    for age, name in enumerate(("new.safetensors", "old.safetensors")):
        (folder / name).write_text("")
        os.utime(folder / name, (1000 - age, 1000 - age))
    return folder


def test_a_scene_without_forests_has_no_newest_one(scene):
    assert newest_forest(scene) is None


def test_a_forest_whose_writing_is_not_finished_is_not_the_newest(scene, folder):
    (folder / ".part-newer.safetensors").write_text("")
    assert newest_forest(scene) == folder / "new.safetensors"


def test_a_forest_that_vanishes_meanwhile_is_passed_over(scene, folder, monkeypatch):
    stat = Path.stat

    def vanishing(path, **options):
        if path.name == "new.safetensors":
            path.unlink(missing_ok=True)
        return stat(path, **options)

    monkeypatch.setattr(Path, "stat", vanishing)
    assert newest_forest(scene) == folder / "old.safetensors"
    shutil.rmtree(folder)
    assert newest_forest(scene) is None
