"""Training on captured frames at the ends: what is spoilt is left out or refused in one line."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.base.compute_device import device_arrays
from hybrid.preparation.forest_errors import held_out_quality
from hybrid.preparation.forest_training import LeftOut, say_left_out, train
from pathtrace.dataset.capture import capture
from pathtrace.dataset.captured_frames import read_frame, write_frame
from pathtrace.dataset.frame_set import CaptureSettings, FrameSet, read_frame_set
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest
from splat.lod.forest_renderer import ForestRenderer
from splat.training.trainer import TrainingSettings
from tests import small
from tests.extremes import extreme
from tests.hybrid.preparation.conftest import ignore
from tests.placed import placed

SETTINGS = TrainingSettings(iterations=8, gaussians=200, layers=2, degree=0)


def spoilt(frames: FrameSet, folder, numbers: list[int], **values: float) -> FrameSet:
    """A copy of a frame set in which some frames have a spoilt pixel, or nothing but spoilt ones."""
    shutil.copytree(frames.folder, folder)
    for number in numbers:
        file = folder / frames.entries[number].file.relative_to(frames.folder)
        frame = read_frame(file)
        changed = {}
        for name, value in values.items():
            changed[name] = getattr(frame, name).copy()
            changed[name][...] = value
        write_frame(file, replace(frame, **changed))
    return read_frame_set(folder)


@extreme("a spoilt frame among captured ones", given="NaN in 1 of 3", expected="left out, said in one line")
def test_a_spoilt_frame_is_left_out_and_said(frames, tmp_path, caplog, got):
    training = [n for n, entry in enumerate(frames.entries) if not entry.held_out]
    bad = spoilt(frames, tmp_path / "frames", training[1:2], radiance=np.nan)
    found: list[LeftOut] = []
    forest = train(bad, tmp_path / "f", SETTINGS, report=found.append)
    assert found == [LeftOut(1, 0)]
    assert forest.nodes.gaussians.is_finite()
    say_left_out(found[0])
    (said,) = caplog.messages
    assert got(said).startswith("Left out of the training: 1 frames with numbers that are not finite")
    say_left_out(LeftOut(0, 0))
    assert len(caplog.messages) == 1


@pytest.mark.parametrize(
    ("values", "message"),
    [
        pytest.param(
            values,
            message,
            marks=extreme(name, given=given, expected="refused in one line, no file written"),
        )
        for values, message, name, given in [
            ({"radiance": np.nan}, "none of 3 frames holds only finite", "all captured frames spoilt", "NaN"),
            (
                {"unfolded": np.inf, "depth": np.inf},
                "no frame shows a surface",
                "all captured frames of the sky",
                "inf as distance",
            ),
        ]
    ],
)
def test_spoilt_frame_sets_are_refused(values, message, frames, tmp_path, got):
    bad = spoilt(frames, tmp_path / "frames", list(range(len(frames.entries))), **values)
    with pytest.raises(UserError, match=message) as caught:
        train(bad, tmp_path / "f", SETTINGS)
    assert "\n" not in str(caught.value)
    got(str(caught.value).split("/")[-1])
    assert [path.name for path in tmp_path.iterdir()] == ["frames"]


def test_held_out_frames_that_are_spoilt_are_not_measured(frames, trained, tmp_path):
    held_out = [n for n, entry in enumerate(frames.entries) if entry.held_out]
    bad = spoilt(frames, tmp_path / "frames", held_out, radiance=np.nan)
    assert "psnr" in held_out_quality(frames, trained)[0]
    assert "psnr" not in held_out_quality(bad, trained)[0]


@extreme(
    "a forest of a distant, tiny scene",
    given="corner scaled by 1e-4 and moved by 1e3: captured, trained, written, read, drawn",
    expected="held-out PSNR within 0.3 dB of the ordinary corner",
)
def test_a_tiny_scene_far_away_ends_as_an_ordinary_one(tmp_path, backend, got):
    settings = CaptureSettings(views=3, held_out=1, width=24, height=24, spp=4, held_out_spp=8)
    training = replace(SETTINGS, iterations=60)
    found = []
    for name, description in (("near", small.corner()), ("far", placed(small.corner(), 1e-4, 1e3))):
        frames = capture(load_scene(description), tmp_path / name, settings, ignore)
        train(frames, tmp_path / f"{name}.forest", training)
        forest = load_forest(tmp_path / f"{name}.forest")
        found.append(held_out_quality(frames, forest)[-1]["psnr"])
        image = ForestRenderer(device_arrays(), forest).render_layer(frames.training[0].camera, 2).numpy()
        assert image.mean() > 0.05
    assert got(found[1] - found[0], "+.2f") == pytest.approx(0, abs=0.3)
