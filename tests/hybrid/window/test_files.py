"""Files of the window are numbered, and none is overwritten."""

from __future__ import annotations

from pathlib import Path

import pytest

from compose.base.errors import UserError
from hybrid.window.gaze_input import unused_file


def test_the_lowest_free_number_is_taken(tmp_path):
    assert unused_file(tmp_path, "room", ".png") == tmp_path / "room-001.png"
    (tmp_path / "room-001.png").touch()
    assert unused_file(tmp_path, "room", ".png") == tmp_path / "room-002.png"
    for number in (2, 4):
        (tmp_path / f"room-00{number}.png").touch()
    assert unused_file(tmp_path, "room", ".png") == tmp_path / "room-003.png"
    assert unused_file(tmp_path, "room", ".csv") == tmp_path / "room-001.csv"
    assert unused_file(tmp_path, "box", ".png") == tmp_path / "box-001.png"


def test_a_folder_that_cannot_be_read_is_named(tmp_path, monkeypatch):
    def fails(self: Path) -> bool:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "exists", fails)
    with pytest.raises(UserError, match=r"cannot be read \(Permission denied\)") as raised:
        unused_file(tmp_path, "room", ".png")
    assert str(raised.value).startswith(str(tmp_path))
