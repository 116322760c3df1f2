"""Files that are written atomically."""

from __future__ import annotations

from pathlib import Path

import pytest

from compose.base.errors import UserError
from compose.base.files import write_whole


def test_a_file_and_its_folder_are_made(tmp_path):
    target = tmp_path / "new" / "folder" / "notes.txt"
    write_whole(target, lambda part: part.write_text("content"))
    assert target.read_text() == "content"
    assert list(target.parent.iterdir()) == [target]


def test_the_target_is_replaced_only_when_it_is_complete(tmp_path):
    target = tmp_path / "notes.txt"
    target.write_text("old")
    seen = []

    def write(part: Path) -> None:
        part.write_text("new")
        seen.append(target.read_text())

    write_whole(target, write)
    assert seen == ["old"]
    assert target.read_text() == "new"


def test_the_partial_file_lies_beside_the_target_and_has_its_extension(tmp_path):
    parts = []
    write_whole(tmp_path / "image.exr", lambda part: parts.append(part) or part.touch())
    assert parts[0].parent == tmp_path
    assert parts[0].suffix == ".exr"
    assert parts[0].name != "image.exr"


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), RuntimeError("No space left on device")]
)
def test_a_failed_write_leaves_the_old_file_and_no_partial_one(tmp_path, error):
    target = tmp_path / "notes.txt"
    target.write_text("old")

    def write(part: Path) -> None:
        part.write_text("half")
        raise error

    with pytest.raises(UserError, match=r"notes.txt: cannot be written \(No space left on device\)"):
        write_whole(target, write)
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_an_interrupted_write_leaves_no_partial_file(tmp_path):
    def write(part: Path) -> None:
        part.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "notes.txt", write)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("path", ["", ".", "/"])
def test_a_path_without_a_name_is_refused(path, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="names a folder"):
        write_whole(Path(path), lambda part: part.write_text("content"))
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="cannot be written"):
        write_whole(tmp_path / "file" / "notes.txt", lambda part: part.write_text("content"))
