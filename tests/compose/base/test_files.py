"""Files that appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from compose.base.errors import UserError
from compose.base.files import write_whole


@pytest.mark.parametrize("path", ["", ".", "/"])
def test_a_path_without_a_name_is_refused(path, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="names a folder"):
        write_whole(Path(path), lambda part: part.write_text("content"))
    assert not list(tmp_path.iterdir())
