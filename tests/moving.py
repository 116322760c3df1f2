"""The small corner with a board that moves."""

from __future__ import annotations

import json
from pathlib import Path

from pathtrace.scene.scene import Scene, load_scene
from tests import small

# How far the board moves to the right, and how it turns.
WAY, DEGREES = 0.9, 60.0
MOTION = {
    "shapes": {
        "board": {
            "about": [-0.6, 0.1, 1.2],
            "keyframes": [{"t": 0}, {"t": 1, "translate": [WAY, 0, 0], "degrees": DEGREES}],
        }
    }
}


def write_motion(folder: Path) -> Path:
    """The motion file, written into a folder."""
    file = folder / "corner.motion.json"
    file.write_text(json.dumps(MOTION))
    return file


def moving_corner(folder: Path) -> Scene:
    """The scene; its motion file is written into a folder."""
    return load_scene(small.corner(), motion=write_motion(folder))
