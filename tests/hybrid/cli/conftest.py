"""What tests of the commands share."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from splat.io.forest_file import load_forest, save_forest


@pytest.fixture
def of_room(made, tmp_path) -> Path:
    """A folder with forest and frame set of the Cornell box, as if they were those of another scene."""
    forest = load_forest(made / "box.forest")
    save_forest(tmp_path / "room.forest", replace(forest, scene_name="room", scene_hash="cd" * 32))
    shutil.copytree(made / "frames", tmp_path / "room-frames")
    description = tmp_path / "room-frames" / "transforms.json"
    document = json.loads(description.read_text())
    document["scene"] |= {"name": "room", "hash": "cd" * 32}
    description.write_text(json.dumps(document))
    return tmp_path
