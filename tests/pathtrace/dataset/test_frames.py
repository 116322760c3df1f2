"""Reading a frame set, also one that another program or an interrupted capture left."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.dataset.frame_set import FORMAT_VERSION, CaptureSettings, read_frame_set

IDENTITY = np.eye(4).tolist()


def entry(name: str, held_out: bool = False) -> dict:
    return {
        "file_path": f"frames/{name}.exr",
        "transform_matrix": IDENTITY,
        "samples": 8,
        "held_out": held_out,
    }


@pytest.fixture
def document() -> dict:
    return {
        "w": 32,
        "h": 24,
        "fl_x": 30.0,
        "fl_y": 31.0,
        "cx": 16.0,
        "cy": 12.0,
        "format_version": FORMAT_VERSION,
        "scene": {"name": "attic", "hash": "abc"},
        "integrator": "cached",
        "frames": [entry("0"), entry("1", held_out=True), entry("2")],
    }


def written(folder: Path, document: dict) -> Path:
    """The folder, with an empty file for each that the document names."""
    (folder / "frames").mkdir()
    for frame in document["frames"]:
        (folder / frame["file_path"]).touch()
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


def test_a_frame_set_is_what_its_document_says(tmp_path, document):
    frames = read_frame_set(written(tmp_path, document))
    assert (frames.folder, frames.scene_name, frames.scene_hash) == (tmp_path, "attic", "abc")
    assert frames.digest == hashlib.sha256((tmp_path / "transforms.json").read_bytes()).hexdigest()
    assert [e.file for e in frames.training] == [tmp_path / "frames/0.exr", tmp_path / "frames/2.exr"]
    (held_out,) = frames.held_out
    assert (held_out.samples, held_out.held_out) == (8, True)
    assert frames.integrator == "cached"
    assert (held_out.camera.width, held_out.camera.fx) == (32, 30.0)


def test_frames_may_have_intrinsics_of_their_own(tmp_path, document):
    """Without those, an entry has the document's."""
    document["frames"][1] |= {"w": 16, "h": 12, "fl_x": 60.0, "fl_y": 62.0}
    (own,) = read_frame_set(written(tmp_path, document)).held_out
    assert (own.camera.width, own.camera.height, own.camera.fy, own.camera.cx) == (16, 12, 62.0, 16.0)


def test_frame_sets_of_earlier_versions_are_read(tmp_path, document):
    """Estimates, halves and parts of held-out views are left alone, whether or not their files are there."""
    plain = read_frame_set(written(tmp_path, document))
    for frame in document["frames"]:
        frame |= {"estimates": [{"samples": 1, "file_path": "frames/1-1.exr"}], "halves": ["frames/1-h.exr"]}
    document["close_ups"] = [{**document["frames"][1], "file_path": "frames/1-closer2.exr"}]
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    found = read_frame_set(tmp_path)
    assert found == replace(plain, digest=found.digest)


@pytest.mark.parametrize("name", ["0", "1"])
def test_every_missing_file_is_noticed(tmp_path, document, name):
    written(tmp_path, document)
    (tmp_path / "frames" / f"{name}.exr").unlink()
    with pytest.raises(UserError, match=rf"1 of 3 files are missing \({name}\.exr first\).*resume"):
        read_frame_set(tmp_path)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"format_version": FORMAT_VERSION + 1}, "format version 4, this program reads 3; capture"),
        ({"frames": None}, "not the description of a frame set"),
        ({"scene": {"name": "attic"}}, "not the description of a frame set"),
        ({"w": "wide"}, "not the description of a frame set"),
        ({"w": 0}, "not the description of a frame set"),
        ({"time": 1.5}, "not the description of a frame set .*time 1.5: must be from 0 to 1"),
        ({"courses": [{"name": "door"}]}, "not the description of a frame set"),
    ],
)
def test_other_documents_are_refused(tmp_path, document, change, complaint):
    written(tmp_path, document)
    (tmp_path / "transforms.json").write_text(json.dumps({**document, **change}))
    with pytest.raises(UserError, match=complaint) as caught:
        read_frame_set(tmp_path)
    assert str(tmp_path / "transforms.json") in str(caught.value)


@pytest.mark.parametrize("text", ["{}", "[]", "no JSON"])
def test_text_that_is_no_document_is_refused(tmp_path, text):
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(UserError, match=r"transforms\.json: not the description of a frame set"):
        read_frame_set(tmp_path)


def test_a_folder_without_a_document_is_refused(tmp_path):
    with pytest.raises(UserError, match="not a frame set"):
        read_frame_set(tmp_path)


@pytest.mark.parametrize("field", ["views", "width", "height", "spp", "held_out_spp"])
@pytest.mark.parametrize("value", [0, -3])
def test_counts_and_sizes_must_be_positive(field, value):
    with pytest.raises(ValueError, match=rf"^{field.replace('_', '-')} is {value}; must be positive$"):
        CaptureSettings(**{field: value})


def test_no_view_need_be_held_out():
    assert CaptureSettings(held_out=0).held_out == 0
    with pytest.raises(ValueError, match=r"^held-out is -1; must not be negative$"):
        CaptureSettings(held_out=-1)


@pytest.mark.parametrize("fov", [0, -1, 180, float("nan"), float("inf")])
def test_a_field_of_view_is_less_than_half_of_all_directions(fov):
    with pytest.raises(ValueError, match=r"^fov is \S+; must be over 0 and under 180 degrees$"):
        CaptureSettings(fov=fov)


def test_numbers_of_numpy_are_numbers():
    settings = CaptureSettings(views=np.int64(3), width=np.uint16(32))
    assert (settings.views, settings.width) == (3, 32)
    json.dumps(asdict(settings))
