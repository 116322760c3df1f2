"""The examples and the README's Python run as they are printed."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import pytest
from PIL import Image

from hybrid.render.image_files import read_exr
from tests.hybrid.command import TINY_CAPTURE, TINY_TRAINING, run

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.usefixtures("backend")


def run_example(monkeypatch, name: str, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
    runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")


def test_a_frame_from_nothing_and_its_parts(monkeypatch, tmp_path):
    run_example(monkeypatch, "render_frame.py", "cornell", tmp_path, "--quick")
    composite = read_exr(tmp_path / "frame.exr")["composite.R"]
    with Image.open(tmp_path / "frame.png") as frame:
        assert frame.size == composite.shape[::-1]
    run_example(
        monkeypatch, "parts_of_a_frame.py", "cornell", tmp_path / "scene.forest", tmp_path / "parts.png"
    )
    with Image.open(tmp_path / "parts.png") as parts:
        # Four pictures beside each other, each with something in it.
        width = (parts.width + 8) // 4
        for number in range(4):
            picture = parts.crop((number * width, 0, number * width + width - 8, width - 8))
            assert picture.convert("L").getextrema()[1] > 60


def test_the_readme_s_python_runs(monkeypatch, tmp_path):
    text = (ROOT / "README.md").read_text()
    snippet = re.search(r"<!-- python -->\n```python\n(.*?)```", text, re.DOTALL)
    assert snippet is not None
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HYBRID_HOME", str(tmp_path / "home"))
    assert run(monkeypatch, "capture", "cornell", "frames", *TINY_CAPTURE) == 0
    assert run(monkeypatch, "train", "frames", "room.forest", *TINY_TRAINING) == 0
    # The small scene stands in for the large one, which takes minutes to train.
    exec(snippet[1].replace('"room"', '"cornell"'), {})
    assert {"composite.R", "fovea.G", "splat.B", "depth.V"} <= set(read_exr(tmp_path / "frame.exr"))
