"""How far a still picture falls back."""

from __future__ import annotations

import pytest

from hybrid.bench.still import most_fall


def test_the_largest_fall_below_the_best_frame_so_far_counts():
    psnr = [30.0, 34.0, 33.5, 35.0, 34.2, 36.0]
    frames = [{"seconds": 2.0 + n, "psnr": value} for n, value in enumerate(psnr)]
    assert most_fall(frames) == pytest.approx(0.8)


def test_frames_of_the_first_second_do_not_count():
    frames = [{"seconds": s, "psnr": p} for s, p in ((0.1, 30.0), (0.5, 20.0), (3.0, 31.0))]
    assert most_fall(frames) == 0.0
