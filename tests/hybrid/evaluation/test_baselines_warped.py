"""The mapping of RMFR, and the filter of its way back."""

from __future__ import annotations

import numpy as np
import pytest

from compose.eye.gaze import Gaze
from hybrid.evaluation.baselines_warped import Axis, Warp, weights

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


@pytest.mark.parametrize("is_noisy", [False, True])
def test_a_smooth_picture_comes_back(is_noisy):
    warp = Warp.of(Gaze(0.4, 0.6), 96, 64, 0.3, 1.0)
    left, top, width, height = warp.boxes()
    picture = lambda x, y: np.stack([x / 96, y / 64, x * y / 96 / 64], axis=-1)  # noqa: E731
    buffer = picture(left + width / 2, top + height / 2).reshape(64, 96, 3).astype(np.float32)
    x, y = np.meshgrid(np.arange(96) + 0.5, np.arange(64) + 0.5)
    np.testing.assert_allclose(warp.frame(buffer, is_noisy)[2:-2, 2:-2], picture(x, y)[2:-2, 2:-2], atol=0.02)


def test_the_gazes_surroundings_are_sharp():
    """A checkerboard of single pixels survives where the buffer is denser than the frame, nowhere else."""
    size, warp = 256, Warp.of(Gaze(), 256, 256, 0.05, 2.0)
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    left, top, width, height = warp.boxes()
    column, row = np.floor(left + width / 2).astype(int), np.floor(top + height / 2).astype(int)
    board = lambda x, y: ((x + y) % 2).astype(np.float32)  # noqa: E731
    buffer = np.repeat(board(column, row).reshape(128, 128, 1), 3, axis=2)
    error = np.abs(warp.frame(buffer, is_noisy=False)[..., 0] - board(x, y))
    assert error[126:130, 126:130].mean() < 0.3 < error[:, :64].mean()


def test_a_buffer_has_at_least_one_pixel():
    warp = Warp.of(Gaze(0.2, 0.9), 6, 4, 0.1, 100.0)
    assert (warp.across.buffer, warp.down.buffer) == (1, 1)
    left, top, width, height = warp.boxes()
    assert (left[0], top[0], width[0], height[0]) == pytest.approx((0, 0, 6, 4))
    frame = warp.frame(np.full((1, 1, 3), 0.7, dtype=np.float32), is_noisy=False)
    np.testing.assert_allclose(frame, np.full((4, 6, 3), 0.7), rtol=1e-6)


def plain_weights(axis: Axis, is_noisy: bool) -> np.ndarray:
    """Pixel by pixel in float64, over a buffer with its border repeated."""
    found = np.zeros((axis.size, axis.buffer))
    for pixel in range(axis.size):
        start, centre, stop = (float(axis.buffer_of(np.array([pixel + part]))[0]) for part in (0, 0.5, 1))
        width = max(stop - start, 1)
        for tap in range(-40, axis.buffer + 40):
            x = abs(tap + 0.5 - centre) / width
            if x >= 2:
                continue
            cubic = 1.5 * x**3 - 2.5 * x**2 + 1 if x < 1 else -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
            found[pixel, min(max(tap, 0), axis.buffer - 1)] += np.exp(-2 * x**2) if is_noisy else cubic
    return found / found.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("is_noisy", [False, True])
@pytest.mark.parametrize(
    ("gaze", "f", "size", "buffer"), [(0.4, 0.1, 60, 40), (0.0, 3.0, 50, 50), (1.0, 0.02, 9, 4)]
)
def test_weights_are_those_of_the_filters(is_noisy, gaze, f, size, buffer):
    axis = Axis(gaze, f, size, buffer)
    found = weights(axis, is_noisy)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found.toarray(), plain_weights(axis, is_noisy), atol=1e-6)


def test_a_dense_buffer_is_averaged_and_a_sparse_one_interpolated():
    """At the gaze, 2.3 pixels of the buffer per pixel of the frame; at the edge, one for many."""
    axis = Axis(0.5, 0.1, 260, 100)
    for is_noisy in (False, True):
        variance = (weights(axis, is_noisy).toarray() ** 2).sum(axis=1)
        assert variance[129:131].max() < 0.5
        assert variance[:30].max() > 0.75


def test_overshoot_is_cut_at_0():
    buffer = np.zeros((8, 8, 3), dtype=np.float32)
    buffer[:, 4:] = 5
    frame = Warp.of(Gaze(), 16, 16, 1e9, 2.0).frame(buffer, is_noisy=False)
    assert frame.min() == 0
    assert frame.max() > 5.1
