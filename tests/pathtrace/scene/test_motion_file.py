"""Motion files and what is wrong with some, formulas, and where tracks are at a time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compose.base.errors import UserError
from pathtrace.scene.motion_file import (
    Brightness,
    Formula,
    Keyframe,
    LightTrack,
    MeshTrack,
    RigidTrack,
    read_motion,
)

RIGID = {"axis": [0, 0, 2], "about": [1, 2, 3], "keyframes": [{"t": 0}, {"t": 1, "degrees": 90}]}
WHOLE: dict[str, Any] = {
    "seconds": 4,
    "shapes": {
        "door": RIGID,
        "flag": {"formula": ["x", "y + t", "z"]},
        "cloth": {"meshes": ["a.ply", "b.ply"]},
    },
    "lights": {"lamp": {"keyframes": [{"t": 0}, {"t": 1, "factor": [1, 0.5, 0]}]}},
}


def written(folder: Path, content: Any) -> Path:
    for name in ("a.ply", "b.ply"):
        (folder / name).write_text(name)
    file = folder / "scene.motion.json"
    file.write_text(content if isinstance(content, str) else json.dumps(content))
    return file


def test_a_motion_file_has_tracks_of_every_kind(tmp_path):
    motion = read_motion(written(tmp_path, WHOLE))
    assert motion.seconds == 4
    door, flag, cloth = (motion.shapes[name] for name in ("door", "flag", "cloth"))
    assert isinstance(door, RigidTrack)
    assert (door.axis, door.about, door.keyframes[1].degrees) == ((0, 0, 1), (1, 2, 3), 90)
    assert isinstance(flag, Formula)
    assert flag.texts == ("x", "y + t", "z")
    assert isinstance(cloth, MeshTrack)
    assert cloth.files == (tmp_path / "a.ply", tmp_path / "b.ply")
    assert motion.lights["lamp"].factor(1.0).tolist() == [1, 0.5, 0]


def test_the_fingerprint_is_that_of_all_files(tmp_path):
    file = written(tmp_path, WHOLE)
    before = read_motion(file).fingerprint
    assert read_motion(file).fingerprint == before
    (tmp_path / "b.ply").write_text("other")
    other = read_motion(file).fingerprint
    assert other != before
    assert read_motion(written(tmp_path, {**WHOLE, "seconds": 5})).fingerprint not in (before, other)


def shape(track: Any) -> dict[str, Any]:
    return {"shapes": {"door": track}}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "cannot be read"),
        ([], "is no motion"),
        ({"shapes": []}, "is no motion"),
        ({}, "nothing moves"),
        ({**WHOLE, "seconds": 0}, "seconds is 0; must be a positive number"),
        ({**WHOLE, "seconds": "4"}, "seconds is '4'; must be a positive number"),
        (shape(7), "shapes: door: is no track"),
        (shape({}), "must have one of keyframes, formula and meshes"),
        (shape({**RIGID, "formula": ["x", "y", "z"]}), "must have one of keyframes, formula and meshes"),
        (shape({**RIGID, "axes": [0, 0, 1]}), "axes is unknown here; may have about, axis, keyframes"),
        (shape({**RIGID, "axis": [0, 0, 0]}), "axis has no length"),
        (shape({**RIGID, "about": [0, 0]}), r"about is \[0, 0\]; must be three numbers"),
        (shape({"keyframes": 5}), "keyframes must be a list of objects"),
        (shape({"keyframes": []}), "no keyframes"),
        (shape({"keyframes": [{"t": 0.5}, {"t": 0.2}]}), "keyframes are out of order; t must ascend"),
        (shape({"keyframes": [{"t": 0}, {"t": 2}]}), "a keyframe has t = 2; must be from 0 to 1"),
        (shape({"keyframes": [{"degrees": 9}]}), "t is None; must be a number"),
        (shape({"keyframes": [{"t": 0, "degree": 9}]}), "degree is unknown here"),
        (shape({"keyframes": [{"t": 0, "degrees": 9, "rotation": [1, 0, 0, 0]}]}), "degrees and rotation"),
        (shape({"keyframes": [{"t": 0, "rotation": [1, 0, 0]}]}), "must be four numbers, w, x, y and z"),
        (shape({"keyframes": [{"t": 0, "rotation": [1, 1, 0, 0]}]}), "must be a unit quaternion"),
        (
            shape({"keyframes": [{"t": 0, "rotation": [1, 0, 0, 0]}, {"t": 1}]}),
            "in all keyframes, or in none",
        ),
        (shape({"formula": ["x", "y"]}), "formula must be three texts"),
        (shape({"formula": ["x", "y", "open(z)"]}), "in a formula; may hold"),
        (shape({"meshes": ["a.ply"]}), "meshes must be two files or more"),
        (shape({"meshes": ["a.ply", "c.ply"]}), "c.ply does not exist"),
        ({"lights": {"lamp": {"keyframes": [{"t": 0, "factor": -1}]}}}, "lights: lamp: factor is negative"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path, content, said):
    file = written(tmp_path, content)
    with pytest.raises(UserError, match=said) as error:
        read_motion(file)
    assert str(error.value).startswith(f"{file}: ")
    assert "\n" not in str(error.value)


def test_keyframes_may_have_quaternions(tmp_path):
    keys = [{"t": 0, "rotation": [1, 0, 0, 0]}, {"t": 1, "rotation": [0, 0.6, 0.8, 0]}]
    door = read_motion(written(tmp_path, shape({"keyframes": keys}))).shapes["door"]
    assert isinstance(door, RigidTrack)
    assert [key.rotation for key in door.keyframes] == [(1, 0, 0, 0), (0, 0.6, 0.8, 0)]


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"none\.json: cannot be read"):
        read_motion(tmp_path / "none.json")


REST = np.random.default_rng(3).normal(size=(50, 3))


def test_formulas_are_arithmetic():
    formula = Formula(("x", "y + 0.5 * sin(2 * pi * (t + x)) ** 2", "max(z, -t) / (1 + abs(x)) - cos(0)"))
    x, y, z = REST.T
    for t in (0.0, 0.3, 1.0):
        expected = [x, y + 0.5 * np.sin(2 * np.pi * (t + x)) ** 2, np.maximum(z, -t) / (1 + np.abs(x)) - 1]
        np.testing.assert_allclose(formula.positions(REST, t), np.stack(expected, axis=1), atol=1e-12)


def test_a_constant_is_the_same_for_all_vertices():
    np.testing.assert_array_equal(Formula(("1", "t", "z")).positions(REST, 0.25)[:, :2], [[1, 0.25]] * 50)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os')",
        "x.real",
        "x[0]",
        "lambda: x",
        "x if t else y",
        "x < y",
        "u",
        "True",
        "'x'",
        "1j",
        "open(x)",
        "sin(x, y)",
        "sin()",
        "max(x)",
        "sin(x=1)",
        "sin(*x)",
        "x +",
        "",
        "x; y",
        "x" + " + x" * 500,
    ],
)
def test_anything_else_is_refused(text):
    with pytest.raises(ValueError, match=r"formula"):
        Formula(("x", text, "z"))


@pytest.mark.parametrize(
    ("text", "time"), [("1 / (t - 0.5)", 0.5), ("sqrt(t - 1)", 0.0), ("exp(1e4 * t)", 1.0)]
)
def test_positions_must_be_finite(text, time):
    formula = Formula(("x", "y", text))
    with pytest.raises(ValueError, match=rf"no finite value for every vertex at t = {time:g}"):
        formula.positions(REST, time)


def test_a_rigid_track_turns_about_its_axis_and_shifts():
    track = RigidTrack(
        (Keyframe(0.2), Keyframe(0.6, (2.0, 0, 0), 180.0)), axis=(0.0, 0.0, 1.0), about=(1.0, 0.0, 0.0)
    )
    half = track.pose(0.4)
    np.testing.assert_allclose(half @ [1, 0, 5, 1], [2, 0, 5, 1], atol=1e-12)
    np.testing.assert_allclose(half @ [2, 0, 0, 1], [2, 1, 0, 1], atol=1e-12)
    for early, late in ((0.0, 0.2), (1.0, 0.6)):
        np.testing.assert_array_equal(track.pose(early), track.pose(late))
    np.testing.assert_array_equal(track.pose(0.0), np.eye(4))


def test_poses_are_rigid_around_any_axis():
    axis = np.array([1.0, -2.0, 0.5])
    x, y, z = (axis / np.linalg.norm(axis)).tolist()
    track = RigidTrack((Keyframe(0.0), Keyframe(1.0, (0.1, 0.2, 0.3), 1234.0)), (x, y, z), (3.0, 1.0, 2.0))
    rotation = track.pose(0.7)[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation @ [x, y, z], [x, y, z], atol=1e-12)
    assert np.trace(rotation) == pytest.approx(1 + 2 * np.cos(np.radians(0.7 * 1234)))


def test_quaternions_turn_around_any_axis_at_a_constant_speed():
    half, third = np.radians(80) / 2, np.radians(80) / 6
    axis = np.array([1.0, 2.0, -2.0]) / 3
    x, y, z = (np.sin(half) * axis).tolist()
    # The negative of a quaternion is the same turn.
    keys = (
        Keyframe(0.1, rotation=(1.0, 0, 0, 0)),
        Keyframe(0.7, (3.0, 0, 0), rotation=(-np.cos(half), -x, -y, -z)),
    )
    track = RigidTrack(keys, about=(0.0, 5.0, 0.0))
    wanted = Rotation.from_quat([*(np.sin(third) * axis), np.cos(third)]).as_matrix()
    pose = track.pose(0.3)
    np.testing.assert_allclose(pose[:3, :3], wanted, atol=1e-12)
    np.testing.assert_allclose(pose @ [0, 5, 0, 1], [1, 5, 0, 1], atol=1e-12)
    np.testing.assert_allclose(track.pose(1.0), track.pose(0.7), atol=1e-12)


def test_a_single_quaternion_holds_for_ever():
    track = RigidTrack((Keyframe(0.5, rotation=(0.0, 0.0, 0.0, 1.0)),))
    for time in (0.0, 0.5, 1.0):
        np.testing.assert_allclose(track.pose(time), np.diag([-1.0, -1, 1, 1]), atol=1e-12)


def test_quaternions_are_in_all_keyframes_or_in_none():
    with pytest.raises(ValueError, match="rotation in all keyframes, or in none"):
        RigidTrack((Keyframe(0.0), Keyframe(1.0, rotation=(1.0, 0.0, 0.0, 0.0))))


def test_brightness_is_linear_between_keyframes():
    track = LightTrack((Brightness(0.0, (1.0, 1.0, 1.0)), Brightness(0.5, (0.0, 2.0, 1.0))))
    np.testing.assert_allclose(track.factor(0.25), [0.5, 1.5, 1])
    np.testing.assert_allclose(track.factor(0.9), [0, 2, 1])


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([], "no keyframes"),
        ([0.5, 0.2], "out of order"),
        ([0.5, 0.5], "out of order"),
        ([-0.1, 0.5], "t = -0.1; must be from 0 to 1"),
        ([0, 1.5], "t = 1.5; must be from 0 to 1"),
    ],
)
def test_keyframes_are_in_order_and_within_the_time(times, said):
    with pytest.raises(ValueError, match=said):
        RigidTrack(tuple(Keyframe(time) for time in times))
    with pytest.raises(ValueError, match=said):
        LightTrack(tuple(Brightness(time, (1.0, 1.0, 1.0)) for time in times))
