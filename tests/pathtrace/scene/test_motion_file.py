"""Motion files, and what is wrong with some."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from compose.base.errors import UserError
from pathtrace.scene.motion_file import Formula, MeshTrack, RigidTrack, read_motion

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
