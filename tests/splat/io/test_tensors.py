"""Tensors and metadata read back equal."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from compose.base.errors import UserError
from splat.io.tensors import FORMAT_VERSION, load_tensors, save_tensors


def test_tensors_and_metadata_read_back_equal(tmp_path):
    tensors = {
        "floats": torch.arange(6.0).reshape(2, 3).T,
        "numbers": torch.tensor([1, -2], dtype=torch.int32),
        "flags": torch.tensor([True, False]),
        "none": torch.zeros(3, 0),
    }
    metadata = {"format_version": FORMAT_VERSION, "list": [1, 2.5, "x"], "nested": {"a": None}}
    save_tensors(tmp_path / "sub" / "t", tensors, metadata)
    found, back = load_tensors(tmp_path / "sub" / "t")
    assert back == metadata
    assert found.keys() == tensors.keys()
    for name, tensor in tensors.items():
        assert torch.equal(found[name], tensor)
        assert found[name].dtype == tensor.dtype


def test_a_failed_write_leaves_the_old_file(tmp_path):
    save_tensors(tmp_path / "t", {"a": torch.ones(2)}, {})
    with pytest.raises(TypeError):
        save_tensors(tmp_path / "t", {"a": torch.zeros(2)}, {"bad": object()})
    assert load_tensors(tmp_path / "t")[0]["a"].tolist() == [1, 1]
    assert [path.name for path in tmp_path.iterdir()] == ["t"]


def test_other_versions_and_damage_are_named(tmp_path):
    with pytest.raises(UserError, match="nowhere: no such file"):
        load_tensors(tmp_path / "nowhere")
    save_tensors(tmp_path / "old", {"a": torch.ones(2)}, {"format_version": 1})
    with pytest.raises(UserError, match="old: format version 1, this program reads 2"):
        load_tensors(tmp_path / "old")
    (tmp_path / "text").write_text("not tensors")
    with pytest.raises(UserError, match="text: truncated or corrupt"):
        load_tensors(tmp_path / "text")


def test_files_of_other_programs_have_no_metadata(tmp_path):
    from safetensors.torch import save_file

    save_file({"a": torch.ones(2)}, tmp_path / "plain")
    tensors, metadata = load_tensors(tmp_path / "plain")
    assert tensors["a"].tolist() == [1, 1]
    assert metadata == {}


def test_the_same_content_is_the_same_file(tmp_path):
    """Also in a process of its own, whose hash tables have another order."""
    program = (
        "import sys, torch; from pathlib import Path; from splat.io.tensors import save_tensors\n"
        "for file in sys.argv[1:]:\n"
        "    save_tensors(Path(file), {'b': torch.ones(3), 'a': torch.zeros(2)}, {'y': 1, 'x': [2.5]})"
    )
    files = [tmp_path / f"{number}.safetensors" for number in range(10)]
    command = [sys.executable, "-c", program, *map(str, files[:5])]
    subprocess.run(command, check=True, cwd=Path(__file__).parents[3])
    for file in files[5:]:
        save_tensors(file, {"b": torch.ones(3), "a": torch.zeros(2)}, {"y": 1, "x": [2.5]})
    assert len({file.read_bytes() for file in files}) == 1
