"""The description of a capture: which frames, how many samples, cameras that other programs understand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.camera import Camera, camera_from_pose, look_at
from pathtrace.dataset.capture import describe_capture, write_description
from pathtrace.dataset.frame_set import CaptureSettings
from pathtrace.region.neighbourhood import ViewSet
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator

SETTINGS = CaptureSettings(views=6, held_out=4, width=32, height=24, spp=2, held_out_spp=16, seed=5)


def camera(x: float) -> Camera:
    pose = look_at(np.array([x, 0.5, -1]), np.array([0.1, 0.0, 2]), np.array([0.0, 1, 0]))
    return camera_from_pose(pose, 32, 24, 30.0, 31.0, 16.5, 12.0)


# Two cameras that are always trained on, and eight of which four are held out.
VIEWS = ViewSet([camera(x) for x in (0, 0.1)], [camera(x) for x in np.linspace(0.2, 0.9, 8)], [0.0] * 10)


def described(**changes) -> dict:
    settings = CaptureSettings(**{**SETTINGS.__dict__, **changes})
    scene = Scene("attic", "abc", None, camera(0), 6, 6, "abc")
    return describe_capture(scene, VIEWS, settings, Integrator.CACHED)


def test_the_document_names_scene_settings_and_intrinsics():
    document = described()
    assert document["scene"] == {"name": "attic", "hash": "abc", "max_depth": 6}
    assert document["settings"]["held_out_spp"] == 16
    assert document["integrator"] == "cached"
    assert document["camera_model"] == "OPENCV"
    intrinsics = {name: document[name] for name in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
    assert intrinsics == {"w": 32, "h": 24, "fl_x": 30.0, "fl_y": 31.0, "cx": 16.5, "cy": 12.0}
    assert document["format_version"] == 3
    assert json.loads(json.dumps(document)) == document


def test_held_out_views_are_spaced_evenly_over_the_spread_ones():
    frames = described()["frames"]
    assert [i for i, frame in enumerate(frames) if frame["held_out"]] == [3, 5, 7, 9]
    assert [frame["samples"] for frame in frames] == [2, 2, 2, 16, 2, 16, 2, 16, 2, 16]
    assert [frame["file_path"] for frame in frames[:2]] == ["frames/0000.exr", "frames/0001.exr"]
    assert not any(frame["held_out"] for frame in described(held_out=0)["frames"])
    assert [i for i, f in enumerate(described(held_out=8)["frames"]) if f["held_out"]] == list(range(2, 10))


def test_cameras_are_in_the_nerfstudio_convention():
    """A point projected with nothing but the file's own numbers lands where the camera has it."""
    document = json.loads(json.dumps(described()))
    point = np.array([0.1, 0.0, 1.5])
    for frame, view in zip(document["frames"], VIEWS.fixed + VIEWS.spread, strict=True):
        to_camera = np.linalg.inv(np.array(frame["transform_matrix"]))
        x, y, z = to_camera[:3, :3] @ point + to_camera[:3, 3]
        u = document["fl_x"] * x / -z + document["cx"]
        v = document["fl_y"] * -y / -z + document["cy"]
        pixels, depth = view.project(point[None])
        np.testing.assert_allclose([u, v], pixels[0], atol=1e-6)
        assert depth[0] > 0
        assert frame["time"] == 0


def test_more_held_out_views_than_there_are_is_refused():
    with pytest.raises(UserError, match=r"^held-out 9: must be at most 8"):
        described(held_out=9)


def test_an_equal_description_is_kept_and_another_one_refused(tmp_path):
    document, folder = described(), tmp_path / "new"
    write_description(folder, document)
    assert json.loads((folder / "transforms.json").read_text()) == document
    assert (folder / "frames").is_dir()
    (folder / "frames" / "0000.exr").touch()
    write_description(folder, document)
    with pytest.raises(UserError, match="new: holds another capture; choose another folder"):
        write_description(folder, described(seed=6))
    assert json.loads((folder / "transforms.json").read_text()) == document
    assert sorted(Path(p).name for p in folder.rglob("*")) == ["0000.exr", "frames", "transforms.json"]
