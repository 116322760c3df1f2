"""The example that uses the package `splat` alone."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import numpy as np
from PIL import Image

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "splats_alone.py"


def test_it_fits_an_image(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", [str(EXAMPLE)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    before, after = map(float, re.findall(r"\d\.\d+", capsys.readouterr().out))
    assert after < 0.1 * before
    with Image.open(tmp_path / "splats_alone.png") as image:
        target, fit = np.split(np.asarray(image, dtype=float), 2, axis=1)
    # The orange disc on its blue background, on both sides.
    for side in (target, fit):
        assert side[32, 32, 0] > 1.5 * side[32, 32, 2]
        assert side[4, 4, 2] > 1.5 * side[4, 4, 0]
