"""Frame sets that grow: views and samples are added, and what is there stays of use."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.dataset.captured_frames import read_frame
from pathtrace.dataset.frame_set import read_frame_set
from pathtrace.dataset.growing import GrowingFrames, Wanted
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace import Integrator
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.extremes import extreme
from tests.moving import moving_corner

FIRST, MORE = (4, 4), (8, 4, 6)


@pytest.fixture(scope="module")
def scene(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture(scope="module")
def tracer(scene) -> Tracer:
    return Tracer(scene)


def frames_in(folder: Path, tracer: Tracer) -> GrowingFrames:
    return GrowingFrames(folder, tracer, Integrator.PATH.value, 3)


def wanted(scene: Scene, samples: tuple[int, ...]) -> list[Wanted]:
    """Views of parts ever further to the right."""
    large = scene.camera.resized(48, 32)
    return [Wanted(large.cropped(8 * number, 8, 24, 16), spp) for number, spp in enumerate(samples)]


def silent(done: int, total: int) -> None:
    pass


def contents(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def test_views_and_samples_are_added(scene, tracer, tmp_path):
    frames = frames_in(tmp_path, tracer)
    frames.grow(wanted(scene, FIRST), silent)
    before = [half.radiance.copy() for half in frames.halves(0)]
    untouched = frames.radiance(1).copy()
    reported: list[tuple[int, int]] = []
    frames.grow(wanted(scene, MORE), lambda *step: reported.append(step))
    assert frames.samples == list(MORE)
    # Four more samples of the first view, and six of the new one.
    assert reported == [(4 * 24 * 16, 10 * 24 * 16), (10 * 24 * 16, 10 * 24 * 16)]
    np.testing.assert_array_equal(frames.radiance(1), untouched)
    for old, new in zip(before, frames.halves(0), strict=True):
        # A half is the mean of its earlier samples and as many new ones, which are not the same again.
        added = 2 * new.radiance - old
        assert not np.allclose(added, old, rtol=1e-3)
        difference = (added - old).mean(axis=-1)
        assert abs(difference.mean()) < 4 * difference.std() / np.sqrt(difference.size)
        assert added.min() > -1e-5
    found = read_frame_set(tmp_path)
    assert [entry.size for entry in found.training] == [(24, 16)] * 3
    # Files of earlier passes are gone.
    assert len(list((tmp_path / "frames").iterdir())) == 3 * len(MORE)


def test_the_halves_are_independent_and_of_equal_size(scene, tracer, tmp_path):
    frames = frames_in(tmp_path, tracer)
    frames.grow(wanted(scene, (5, 2)), silent)
    assert frames.samples == [6, 2]
    one, other = (half.radiance for half in frames.halves(0))
    assert not np.allclose(one, other, rtol=1e-3)


def test_frames_are_opened_again_as_they_were(scene, tracer, tmp_path):
    first = frames_in(tmp_path, tracer)
    first.grow(wanted(scene, FIRST), silent)
    again = frames_in(tmp_path, tracer)
    assert again.samples == first.samples
    again.grow(wanted(scene, MORE), silent)
    assert again.samples == list(MORE)


@extreme(
    "a pass over growing frames interrupted",
    given="Ctrl-C after the first of three views",
    expected="the files of a pass that was not interrupted",
)
def test_an_interrupted_pass_resumes(scene, tracer, tmp_path, got):
    whole, torn = tmp_path / "whole", tmp_path / "torn"
    for folder in (whole, torn):
        frames_in(folder, tracer).grow(wanted(scene, FIRST), silent)
    frames_in(whole, tracer).grow(wanted(scene, MORE), silent)

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        frames_in(torn, tracer).grow(wanted(scene, MORE), interrupt)
    assert frames_in(torn, tracer).samples == list(FIRST)
    frames_in(torn, tracer).grow(wanted(scene, MORE), silent)
    assert contents(torn) == contents(whole)
    got("the same files")


@extreme(
    "growing frames of other settings, or damaged",
    given="a folder with another seed; a description cut in half",
    expected="one line that names the folder, nothing changed",
)
def test_a_folder_of_other_or_damaged_frames_is_refused(scene, tracer, tmp_path, got):
    frames_in(tmp_path, tracer).grow(wanted(scene, FIRST), silent)
    before = contents(tmp_path)
    with pytest.raises(UserError, match="holds other frames") as refused:
        GrowingFrames(tmp_path, tracer, Integrator.PATH.value, 4)
    assert contents(tmp_path) == before
    description = tmp_path / "transforms.json"
    text = description.read_text(encoding="utf-8")
    description.write_text(text[: len(text) // 2], encoding="utf-8")
    with pytest.raises(UserError, match="is damaged"):
        frames_in(tmp_path, tracer)
    got(str(refused.value).replace(str(tmp_path), "FOLDER"))


def test_views_that_are_there_cannot_change(scene, tracer, tmp_path):
    frames = frames_in(tmp_path, tracer)
    frames.grow(wanted(scene, FIRST), silent)
    other = list(reversed(wanted(scene, MORE)))
    for views in (other, other[:1]):
        with pytest.raises(ValueError, match="must stay"):
            frames.grow(views, silent)
    assert json.loads((tmp_path / "transforms.json").read_text(encoding="utf-8"))["frames"][0]["samples"] == 4


def test_poses_that_are_a_little_less_than_rigid_stay_as_they_are_far_from_the_origin(
    scene, tracer, tmp_path
):
    """Scene files have rounded rotations; their inverses differ by as much as the distance multiplies."""
    pose = scene.camera.world_to_camera.copy()
    pose[0, :3] *= 1 + 2e-5
    pose[:3, 3] = 300.0, -200.0, 500.0
    camera = replace(scene.camera.resized(16, 8), world_to_camera=pose)
    frames_in(tmp_path, tracer).grow([Wanted(camera, 2)], silent)
    again = frames_in(tmp_path, tracer)
    assert np.abs(again.camera(0).world_to_camera - pose).max() > 1e-3
    again.grow([Wanted(camera, 4)], silent)
    assert again.samples == [4]


def test_views_of_a_scene_that_moves_show_their_times(tmp_path):
    """In whatever order they were traced; a view keeps its time."""
    scene = moving_corner(tmp_path)
    tracer, camera = Tracer(scene), scene.camera.resized(24, 16)
    views = [Wanted(camera, 2, time) for time in (0.0, 1.0, 0.5)]
    once = frames_in(tmp_path / "once", tracer)
    once.grow(views, silent)
    twice = frames_in(tmp_path / "twice", tracer)
    twice.grow(views[:1], silent)
    twice.grow(views, silent)
    for view in range(3):
        np.testing.assert_array_equal(once.radiance(view), twice.radiance(view))
    found = read_frame_set(tmp_path / "once")
    assert (
        [entry.time for entry in found.training] == [once.time(view) for view in range(3)] == [0.0, 1.0, 0.5]
    )
    (course,) = found.courses
    assert course.name == "board"
    columns = [np.nonzero(read_frame(entry.file).shape == course.shape)[1].mean() for entry in found.training]
    # Its x axis points to the left.
    assert columns[0] > columns[2] > columns[1]
    with pytest.raises(ValueError, match="must stay as they are"):
        once.grow([replace(views[0], time=0.3), *views[1:]], silent)


def test_frames_of_a_scene_that_stands_still_have_no_courses(scene, tracer, tmp_path):
    frames = frames_in(tmp_path, tracer)
    frames.grow(wanted(scene, (2,)), silent)

    found = read_frame_set(tmp_path)
    assert (found.courses, found.training[0].time) == ((), 0.0)
