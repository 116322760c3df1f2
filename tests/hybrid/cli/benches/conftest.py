"""What tests of the benches share."""

from __future__ import annotations

import json
from pathlib import Path

import pytest


@pytest.fixture
def display(tmp_path) -> Path:
    """A small display."""
    file = tmp_path / "display.json"
    file.write_text(json.dumps({"width": 192, "height": 128, "fov": 60}))
    return file
