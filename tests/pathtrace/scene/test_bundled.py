"""Where scene files are found."""

from __future__ import annotations

import pytest

import pathtrace.scene.scene as module
from compose.base.errors import UserError
from pathtrace.scene.scene import bundled_scenes, scene_file


def test_bundled_scenes_are_found_by_name():
    scenes = bundled_scenes()
    assert {"cornell", "meadow", "room"} <= set(scenes)
    for name, path in scenes.items():
        assert path.suffix == ".xml"
        assert path.parent.name == name
        assert scene_file(name) == path


def test_an_installed_package_brings_its_own_scenes(monkeypatch, tmp_path):
    (tmp_path / "attic").mkdir()
    file = tmp_path / "attic" / "attic.xml"
    file.touch()
    monkeypatch.setattr(module, "_INSTALLED_SCENES", tmp_path)
    assert bundled_scenes() == {"attic": file}


def test_scenes_are_found_by_file_and_by_folder(monkeypatch, tmp_path):
    file = tmp_path / "scene.xml"
    file.touch()
    assert scene_file(file) == scene_file(str(file)) == scene_file(tmp_path) == file.resolve()
    monkeypatch.chdir(tmp_path)
    assert scene_file("scene.xml").is_absolute()


def test_a_missing_scene_is_refused_with_the_names_that_exist(tmp_path):
    for source in (tmp_path / "nowhere.xml", tmp_path):
        with pytest.raises(UserError, match=r"no such scene; name one of .*cornell.*room") as caught:
            scene_file(source)
        assert str(source) in str(caught.value)
