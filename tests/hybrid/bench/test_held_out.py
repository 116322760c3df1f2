"""The forest's periphery in held-out frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from compose.base.errors import UserError
from compose.eye.acuity import ACUITY_MODELS
from hybrid.bench.held_out import bench_held_out
from hybrid.frame.settings import FrameSettings
from pathtrace.dataset.frames import read_frame_set
from splat.io.forest_file import load_forest

SETTINGS = FrameSettings(fov_a=20, fov_b=20)


def test_a_larger_converged_disc_is_closer_to_the_reference(made: Path, backend):
    frames, forest = read_frame_set(made / "frames"), load_forest(made / "box.forest")
    narrow, wide = (
        bench_held_out(frames, forest, replace(SETTINGS, fov_a=r, fov_b=r), lambda done, total: None)
        for r in (10.0, 45.0)
    )
    assert [row["acuity_model"] for row in narrow] == list(ACUITY_MODELS)
    assert all(b["psnr"] > a["psnr"] for a, b in zip(narrow, wide, strict=True))


def test_without_held_out_frames_there_is_nothing_to_measure(made: Path, backend):
    frames = replace(read_frame_set(made / "frames"), entries=[])
    with pytest.raises(UserError, match="held-out"):
        bench_held_out(frames, load_forest(made / "box.forest"), SETTINGS, lambda done, total: None)
