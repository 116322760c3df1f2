"""The example that is a script for gsplat but for one import."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "gsplat_training.py"


def test_it_learns_views_that_it_was_not_trained_on(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", [str(EXAMPLE), "51"])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    printed = capsys.readouterr().out
    losses = [float(value) for value in re.findall(r"loss (\S+),", printed)]
    psnr = [float(value) for value in re.findall(r"PSNR (\S+) dB", printed)]
    assert losses[-1] < 0.5 * losses[0]
    assert psnr[-1] > psnr[0] + 3
    assert float(re.findall(r"screen (\S+) per px", printed)[0]) > 0
