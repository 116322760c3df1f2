"""Preparations that go on from others: of a scene before it was changed, and near another place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compose.camera.camera import Camera, turned
from hybrid.base.cache_folder import scene_folder
from hybrid.base.progress import no_bars
from hybrid.preparation.earlier_jobs import JOURNAL, earlier_job, newest_job
from hybrid.preparation.preparation import Beginning, Prepared, Staged, prepare
from hybrid.preparation.stages import PreparationSettings
from pathtrace.dataset import changed_frames
from pathtrace.dataset.frame_set import read_frame_set
from pathtrace.region.neighbourhood import is_elsewhere
from pathtrace.scene.scene import Scene, bundled_scenes, load_scene
from tests.extremes import extreme
from tests.hybrid.preparation.tiny import STAGES, make_tiny, tiny_home

pytestmark = pytest.mark.usefixtures("backend", "own_home")
LIVE = PreparationSettings(quality="live", held_out=0)
VIEWS = sum(stage.views for stage in STAGES)


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    make_tiny(monkeypatch.setattr)
    # So few samples differ from others in every tile.
    monkeypatch.setattr(changed_frames, "_LIGHT", 0.15)


def prepared_apart(tmp_path_factory, settings: PreparationSettings) -> tuple[Prepared, Path]:
    """A preparation of the Cornell box in a cache folder of its own, and where it is."""
    folder = tmp_path_factory.mktemp("prepared")
    with tiny_home(tmp_path_factory.mktemp("home")):
        return prepare(load_scene("cornell"), settings, no_bars, folder), folder


@pytest.fixture(scope="module")
def first(tmp_path_factory, backend) -> tuple[Prepared, Path]:
    """A preparation of the Cornell box, and its folder."""
    return prepared_apart(tmp_path_factory, LIVE)


@pytest.fixture(scope="module")
def short(tmp_path_factory, backend) -> tuple[Prepared, Path]:
    """The same without its last stage."""
    return prepared_apart(tmp_path_factory, replace(LIVE, quality="draft"))


def changed(folder: Path, old: str, new: str) -> Scene:
    """The Cornell box with another text in its file."""
    text, file = bundled_scenes()["cornell"].read_text(), folder / "cornell" / "scene.xml"
    assert old in text
    file.parent.mkdir(exist_ok=True)
    file.write_text(text.replace(old, new))
    return load_scene(file)


def elsewhere(scene: Scene) -> Camera:
    """Where the box looks different: turned to a side wall, from nearer."""
    pose = scene.camera.camera_to_world.copy()
    pose[:3, 3] += 0.35 * scene.surfaces().median_distance(scene.camera) * pose[:3, 2]
    pose[:3, :3] = turned(pose[:3, :3], 40.0, 0.0)
    return scene.camera.resized(64, 48).at(pose)


def gone_on(scene: Scene, beginning: Beginning, folder: Path) -> tuple[Prepared, list[Staged]]:
    told: list[Staged] = []
    return prepare(scene, LIVE, no_bars, folder, beginning=beginning, told=told.append), told


def test_what_has_changed_is_learnt_in_the_frames_that_there_are(first, tmp_path):
    """With a box elsewhere, from the forest of before; interrupted, it goes on likewise."""
    before, folder = first
    scene = changed(tmp_path, "0.35, -0.7, 0.36", "0.25, -0.7, 0.3")
    prepared, told = gone_on(scene, Beginning(before.forest, (folder,)), tmp_path / "now")
    # Two stages after the three that there were.
    assert [(one.number, one.stages) for one in told] == [(4, 5), (5, 5)]
    assert len(read_frame_set(tmp_path / "now" / "frames").training) == VIEWS
    assert prepared.facts["gaussians"] <= STAGES[-1].gaussians
    assert told[-1].psnr > before.facts["trained_psnr"] - 2
    for file in (tmp_path / "now").glob("*forest*"):
        file.unlink()
    again, told = gone_on(scene, Beginning(), tmp_path / "now")
    assert not told
    assert again.forest.digest() == prepared.forest.digest()


def test_the_stages_that_were_planned_follow(first, short, tmp_path):
    """Where the other preparation had not come to them."""
    before, (begun, folder) = first[0], short
    prepared, told = gone_on(load_scene("cornell"), Beginning(begun.forest, (folder,)), tmp_path / "now")
    assert [one.number for one in told] == [3]
    assert len(read_frame_set(tmp_path / "now" / "frames").training) == VIEWS
    assert abs(prepared.facts["trained_psnr"] - before.facts["trained_psnr"]) < 3


def test_a_scene_in_another_light_is_learnt_anew(first, tmp_path):
    scene = changed(tmp_path, "30, 26, 18", "1, 0.9, 0.6")
    _, told = gone_on(scene, Beginning(first[0].forest, (first[1],)), tmp_path / "now")
    assert [(one.number, one.stages) for one in told] == [(1, 3), (2, 3), (3, 3)]
    # From what was traced of it as it is, if anything was.
    glimpse = prepare(scene, replace(LIVE, quality="glimpse"), no_bars, tmp_path / "glimpse")
    jobs = first[1], tmp_path / "glimpse"
    _, told = gone_on(scene, Beginning(glimpse.forest, jobs), tmp_path / "further")
    assert [(one.number, one.stages) for one in told] == [(2, 3), (3, 3)]


def test_another_place_is_learnt_beside_the_first_one(first, tmp_path):
    """All frames of before stay, and further ones are near the place; the forest knows both."""
    before, folder = first
    scene = load_scene("cornell")
    place = elsewhere(scene)
    own = [entry.camera for entry in read_frame_set(folder / "frames").training]
    assert is_elsewhere(scene, place, own)
    _, told = gone_on(scene, Beginning(before.forest, (folder,), place), tmp_path / "now")
    assert [one.number for one in told] == [4, 5]
    cameras = [entry.camera for entry in read_frame_set(tmp_path / "now" / "frames").training]
    assert [camera.key for camera in cameras[:VIEWS]] == [camera.key for camera in own]
    near = cameras[VIEWS:]
    assert len(near) > STAGES[0].views
    # The place itself comes first.
    np.testing.assert_allclose(near[0].position, place.position, atol=1e-6)
    assert not is_elsewhere(scene, place, near)
    # It is a job of its own, from which the next one goes on.
    again = earlier_job(tmp_path / "now")
    assert again is not None
    assert again.place is not None
    assert again.place.key == place.key
    further = gone_on(scene, Beginning(before.forest, (tmp_path / "now",), place), tmp_path / "further")[1]
    # There is nothing left to do near it.
    assert [one.number for one in further] == [1, 2, 3]


def test_the_job_that_traced_last_is_the_newest(first):
    scene = load_scene("cornell")
    assert newest_job(scene) is None
    prepare(scene, replace(LIVE, quality="draft"))
    prepare(scene, replace(LIVE, quality="glimpse"))
    newest = newest_job(scene)
    assert newest is not None
    assert newest.folder.name.startswith("glimpse-")
    assert (len(newest.stages), newest.place) == (1, None)


@extreme(
    "a preparation to go on from that is damaged",
    given="a folder without a journal, with half of one, with frames that are missing",
    expected="begun anew",
)
def test_a_preparation_that_cannot_be_gone_on_from_is_begun_anew(first, short, tmp_path, got, caplog):
    before, folder = first[0], short[1]
    assert earlier_job(tmp_path) is None
    scene, broken = load_scene("cornell"), scene_folder("cornell", "0" * 64) / "live-broken"
    (broken / "frames").mkdir(parents=True)
    journal = (folder / JOURNAL).read_text()
    (broken / JOURNAL).write_text(journal[:200])
    assert earlier_job(broken) is None
    (broken / JOURNAL).write_text(journal)
    (broken / "frames" / "transforms.json").write_text((folder / "frames" / "transforms.json").read_text())
    _, told = gone_on(scene, Beginning(before.forest, (broken,)), tmp_path / "now")
    assert got(told[0].number) == 1
    assert "not gone on from" in caplog.text


def test_a_view_is_elsewhere_by_position_or_direction():
    scene = load_scene("cornell")
    home = scene.camera.resized(64, 48)
    assert not is_elsewhere(scene, home, [scene.camera])
    assert is_elsewhere(scene, elsewhere(scene), [scene.camera])
    turned_only = home.camera_to_world.copy()
    turned_only[:3, :3] = turned(turned_only[:3, :3], 60.0, 0.0)
    away = home.at(turned_only)
    assert not is_elsewhere(scene, away, [scene.camera, away])
    # Nobody learns what shows nothing.
    outside = home.camera_to_world.copy()
    outside[:3, :3] = turned(outside[:3, :3], 180.0, 0.0)
    assert not is_elsewhere(scene, home.at(outside), [scene.camera])
