"""The cache folder: forests and receipts."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from compose.base.errors import UserError
from hybrid.base import cache_folder as cache
from hybrid.base.cache_folder import (
    has_receipt,
    home,
    keep_receipt,
    newest_forest,
    scene_folder,
    store_forest,
)
from pathtrace.dataset.frame_set import read_frame_set
from pathtrace.scene.scene import Scene, load_scene
from splat.io.forest_file import load_forest, save_forest
from splat.model.forest import Forest
from tests import small
from tests.extremes import extreme
from tests.hybrid.forests import white_dot

pytestmark = pytest.mark.usefixtures("backend", "own_home")


@pytest.fixture(scope="module")
def scene(backend):
    return load_scene(small.furnace())


def forest_of_scene(scene: Scene) -> Forest:
    return replace(white_dot((0, 0, 1)), scene_name=scene.name, scene_hash=scene.hash)


@pytest.fixture
def folder(scene):
    """Two finished forests, the older one named last."""
    folder = scene_folder(scene.name, scene.hash) / "forests"
    folder.mkdir(parents=True)
    for age, name in enumerate(("new.safetensors", "old.safetensors")):
        save_forest(folder / name, forest_of_scene(scene))
        os.utime(folder / name, (1000 - age, 1000 - age))
    return folder


def test_the_cache_folder_is_the_platforms_unless_the_environment_names_one(monkeypatch, tmp_path):
    monkeypatch.setenv("HYBRID_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(cache.platformdirs, "user_cache_dir", lambda name: f"/caches/{name}")
    assert home() == tmp_path / "home"
    for unset in (lambda: monkeypatch.setenv("HYBRID_HOME", ""), lambda: monkeypatch.delenv("HYBRID_HOME")):
        unset()
        assert home() == Path("/caches/hybrid")
    # As of a user without a home.
    monkeypatch.setattr(cache.platformdirs, "user_cache_dir", lambda name: f"~/.cache/{name}")
    assert home().is_absolute()
    assert home().name == f"hybrid-{os.getuid()}"


def test_each_version_of_a_scene_has_a_folder_of_its_own():
    folders = {scene_folder(*of) for of in (("a", "12" * 32), ("a", "34" * 32), ("b", "12" * 32))}
    assert len(folders) == 3
    assert {folder.parent for folder in folders} == {home()}
    assert scene_folder("a", "12" * 32).name == "a-121212121212"


def test_the_forest_that_was_stored_last_is_the_newest(scene):
    forest = replace(white_dot((0, 0, 1)), scene_name=scene.name, scene_hash=scene.hash)
    store_forest(replace(forest, scene_hash="ab" * 32), "of-another-scene")
    assert newest_forest(scene) is None
    store_forest(forest, "first")
    assert newest_forest(scene).name == "first.safetensors"
    os.utime(newest_forest(scene), (1000, 1000))
    store_forest(replace(forest, trained_focal=51.0), "again")
    assert load_forest(newest_forest(scene)).trained_focal == 51


def test_a_scene_without_forests_has_no_newest_one(scene):
    assert newest_forest(scene) is None


def test_an_incomplete_file_is_not_the_newest_forest(scene, folder):
    (folder / ".part-newer.safetensors").write_text("")
    assert newest_forest(scene) == folder / "new.safetensors"


def test_files_of_another_kind_are_no_forests(scene, folder):
    (folder / "newer.safetensors.checkpoint").write_text("")
    assert newest_forest(scene) == folder / "new.safetensors"


def test_a_forest_that_vanishes_meanwhile_is_skipped(scene, folder, monkeypatch):
    stat = Path.stat

    def vanishing(path, **options):
        if path.name == "new.safetensors":
            path.unlink(missing_ok=True)
        return stat(path, **options)

    monkeypatch.setattr(Path, "stat", vanishing)
    assert newest_forest(scene) == folder / "old.safetensors"
    shutil.rmtree(folder)
    assert newest_forest(scene) is None


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        pytest.param(
            "../../outside",
            "ab" * 32,
            marks=extreme(
                "scene name that is a path", given="../../outside", expected="refused, nothing written"
            ),
        ),
        pytest.param(
            "/tmp/outside",
            "ab" * 32,
            marks=extreme(
                "scene name from the root", given="/tmp/outside", expected="refused, nothing written"
            ),
        ),
        ("..", "ab" * 32),
        ("a\\b", "ab" * 32),
        ("a\nb", "ab" * 32),
        ("a\0b", "ab" * 32),
        ("n" * 300, "ab" * 32),
        pytest.param(
            "room",
            "../" * 21 + "x",
            marks=extreme(
                "scene hash that is a path", given="../../../ ...", expected="refused, nothing written"
            ),
        ),
        ("room", "AB" * 32),
        ("room", "ab"),
        ("room", ""),
    ],
)
def test_names_and_hashes_that_are_paths_are_refused(name, digest, tmp_path, request):
    forest = replace(white_dot((0, 0, 1)), scene_name=name, scene_hash=digest)
    with pytest.raises(UserError, match=r"scene name|scene hash") as caught:
        store_forest(forest, "f")
    assert str(caught.value).isprintable()
    assert not list(tmp_path.iterdir())
    if request.node.get_closest_marker("extremes"):
        request.getfixturevalue("got")(str(caught.value))


@extreme(
    "forest under another's name",
    given="a newer forest in the folder of a scene, whose hash has the same first 12 digits",
    expected="the older one of the scene",
)
def test_a_forest_of_another_scene_in_the_folder_is_not_the_newest(scene, folder, got):
    other = scene.hash[:12] + "0" * 52
    save_forest(folder / "newer.safetensors", replace(forest_of_scene(scene), scene_hash=other))
    (folder / "damaged.safetensors").write_bytes((folder / "new.safetensors").read_bytes()[:50])
    (folder / "empty.safetensors").write_text("")
    assert got(newest_forest(scene).name) == "new.safetensors"


def test_frames_without_a_receipt_were_not_captured_here(made, monkeypatch):
    frames = read_frame_set(made / "frames")
    assert not has_receipt(frames)
    # The command that captured them kept one.
    monkeypatch.setenv("HYBRID_HOME", str(made / "home"))
    assert has_receipt(frames)


def test_a_receipt_is_of_the_files_and_not_of_their_folder(made, tmp_path):
    keep_receipt(read_frame_set(made / "frames"))
    copy = tmp_path / "copy"
    shutil.copytree(made / "frames", copy)
    assert has_receipt(read_frame_set(copy))


def test_a_receipt_does_not_fit_other_files(made, tmp_path):
    keep_receipt(read_frame_set(made / "frames"))
    copy = tmp_path / "copy"
    shutil.copytree(made / "frames", copy)
    file = read_frame_set(copy).held_out[0].file
    file.write_bytes(file.read_bytes() + b"\0")
    assert not has_receipt(read_frame_set(copy))
