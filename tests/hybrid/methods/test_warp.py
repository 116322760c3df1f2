"""RMFR's mapping: there and back, its ends, its density, and what a frame looks like through it."""

from __future__ import annotations

import numpy as np
import pytest
from hybrid.baselines.warp import Axis, Warp

from compose.eye.gaze import Gaze

GAZES = (0.5, 0.2, 0.0, 1.0)


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("f", [0.02, 0.1, 3.0])
def test_frame_and_buffer_map_to_each_other(gaze, f):
    axis = Axis(gaze, f, 512, 197)
    pixels = np.linspace(0, 512, 401)
    there = axis.buffer_of(pixels)
    np.testing.assert_allclose(axis.frame_of(there), pixels, atol=1e-9)
    assert (np.diff(there) > 0).all()
    np.testing.assert_allclose(there[[0, -1]], [0, 197], atol=1e-12)
    np.testing.assert_allclose(axis.buffer_of(np.array([gaze * 512])), gaze * 197, atol=1e-12)


def test_the_papers_setting_is_dense_in_the_middle_only():
    """sigma 2.6 and f 0.1: 2.3 samples per pixel and side at the gaze, one in 16 pixels at the edge."""
    axis = Axis(0.5, 0.1, 2600, 1000)
    density = np.diff(axis.buffer_of(np.arange(2601.0)))
    assert density[1300] == pytest.approx(6 / 2.6, rel=0.01)
    assert density[0] == pytest.approx(1 / 6 / 2.6, rel=0.01)
    assert density[1300 + 125] > 1 > density[1300 + 135]


@pytest.mark.parametrize("gaze", GAZES)
def test_boxes_cover_the_frame_once(gaze):
    warp = Warp.of(Gaze(gaze, 0.4), 64, 48, 0.1, 2.6)
    left, top, width, height = warp.boxes()
    assert len(left) == 25 * 18
    assert (width * height).sum() == pytest.approx(64 * 48)
    assert min(left.min(), top.min()) == pytest.approx(0, abs=1e-12)
    assert (left + width).max() == pytest.approx(64)
    assert (top + height).max() == pytest.approx(48)


def test_a_smooth_picture_comes_back():
    warp = Warp.of(Gaze(0.4, 0.6), 96, 64, 0.3, 1.0)
    left, top, width, height = warp.boxes()
    picture = lambda x, y: np.stack([x / 96, y / 64, x * y / 96 / 64], axis=-1)  # noqa: E731
    buffer = picture(left + width / 2, top + height / 2).reshape(64, 96, 3).astype(np.float32)
    x, y = np.meshgrid(np.arange(96) + 0.5, np.arange(64) + 0.5)
    np.testing.assert_allclose(warp.frame(buffer)[2:-2, 2:-2], picture(x, y)[2:-2, 2:-2], atol=0.02)


def test_the_gazes_surroundings_are_sharp():
    """A checkerboard of single pixels survives where the buffer is denser than the frame, nowhere else."""
    size, warp = 256, Warp.of(Gaze(), 256, 256, 0.05, 2.0)
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    left, top, width, height = warp.boxes()
    column, row = np.floor(left + width / 2).astype(int), np.floor(top + height / 2).astype(int)
    board = lambda x, y: ((x + y) % 2).astype(np.float32)  # noqa: E731
    buffer = np.repeat(board(column, row).reshape(128, 128, 1), 3, axis=2)
    error = np.abs(warp.frame(buffer)[..., 0] - board(x, y))
    assert error[126:130, 126:130].mean() < 0.3 < error[:, :64].mean()


def test_what_is_no_mapping_is_refused():
    for arguments in ((1.2, 0.1, 10, 5), (0.5, 0.0, 10, 5), (0.5, float("nan"), 10, 5), (0.5, 0.1, 10, 0)):
        with pytest.raises(ValueError, match=r"lies outside|no mapping"):
            Axis(*arguments)
    with pytest.raises(ValueError, match="sigma"):
        Warp.of(Gaze(), 64, 48, 0.1, 0.0)
