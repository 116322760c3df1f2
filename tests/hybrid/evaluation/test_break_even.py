"""Where hybrid frames break even, and how certain ratios are."""

from __future__ import annotations

import pytest

from hybrid.evaluation.sweep_catalogue import break_even, sentence
from hybrid.measure.frame_times import ratio_interval
from tests import small


def only(*ratios: float) -> dict:
    """The row of one size, at radii of 10, 50 and 90 %, of ratios that are known to within 0.1."""
    rows = [
        {"width": 4, "height": 3, "radius": r, "ratio": ratio, "ratio_interval": (ratio - 0.1, ratio + 0.1)}
        for r, ratio in zip((10, 50, 90), ratios, strict=True)
    ]
    (row,) = break_even(rows)
    return row


def test_the_radius_is_interpolated_where_the_ratio_falls_below_1():
    """From 1.5 at 50 % to 0.5 at 90 %: 1 at 70 %; its upper bound, from 1.6 to 0.6, at 74 %."""
    assert only(5.0, 1.5, 0.5)["radius"] == pytest.approx(70)
    assert only(5.0, 1.5, 0.5)["slower_from"] == pytest.approx(74)
    assert only(3.0, 0.5, 0.4)["radius"] == pytest.approx(42)
    # A ratio of exactly 1 is not slower yet.
    assert only(2.0, 1.0, 0.5)["radius"] == pytest.approx(50)


def test_it_may_be_at_no_radius_or_at_the_smallest():
    assert only(5.0, 1.5, 1.1)["radius"] is None
    assert only(5.0, 1.5, 0.95)["slower_from"] is None
    assert only(0.9, 0.8, 0.7)["radius"] == 10
    assert only(1.0, 1.0, 1.0)["radius"] is None


def test_the_first_crossing_counts():
    assert only(0.5, 2.0, 0.5)["radius"] == 10
    rows = [
        {"width": 4, "height": 3, "radius": r, "ratio": ratio, "ratio_interval": (ratio, ratio)}
        for r, ratio in ((10, 2.0), (20, 0.5), (30, 1.5), (40, 0.5))
    ]
    assert break_even(rows)[0]["radius"] == pytest.approx(10 + 20 / 3)


def test_the_lowest_ratio_is_that_of_any_radius():
    assert only(5.0, 0.5, 0.7)["least_ratio"] == 0.5


def test_sizes_stand_apart_beside_fpcs_figure():
    rows = [
        {"width": w, "height": 780, "radius": r, "ratio": w / 1280 / r, "ratio_interval": (0, 0)}
        for w in (1280, 64)
        for r in (0.5, 2.0)
    ]
    first, second = break_even(rows)
    assert (first["width"], first["height"], first["paper"]) == (1280, 780, 51.0)
    assert (second["width"], second["paper"]) == (64, None)
    assert first["radius"] == pytest.approx(0.5 + 1.5 * (2 - 1) / (2 - 0.5))
    assert second["radius"] == 0.5


def test_a_sentence_says_all_of_it():
    assert sentence({**only(5.0, 1.5, 0.95), "paper": 51.0}) == (
        "4x3: as fast as full path tracing at a radius of 86 % of the height (FPC: 51), slower with 95 % "
        "confidence at no radius; lowest ratio 0.950."
    )
    assert "radius of more than 90 % of the height" in sentence({**only(5.0, 1.5, 1.1), "paper": 51.0})
    assert "confidence from 74 % on; lowest ratio 0.500." in sentence({**only(5.0, 1.5, 0.5), "paper": 51.0})


def test_an_interval_holds_the_ratio_and_shrinks_with_more_frames():
    """Frames of 100 and of 80 ms with noise of a tenth: in 95 of 100 runs the interval holds 1.25."""
    rng = small.rng()
    held, widths = {8: 0, 64: 0}, {8: 0.0, 64: 0.0}
    for frames in held:
        for _ in range(200):
            full, ours = (mean * rng.normal(1, 0.1, frames) for mean in (100, 80))
            low, high = ratio_interval(list(full), list(ours))
            held[frames] += low <= 1.25 <= high
            widths[frames] += (high - low) / 200
    assert 180 < held[64] < 200
    assert held[8] > 170
    assert widths[64] < widths[8] / 2


def test_drift_that_both_share_does_not_widen_an_interval():
    """Pairs are drawn together: a machine that gets slower makes both slower."""
    drift = [1 + 0.1 * n for n in range(20)]
    low, high = ratio_interval([150 * d for d in drift], [100 * d for d in drift])
    assert (low, high) == pytest.approx((1.5, 1.5))


def test_an_interval_repeats():
    times = list(small.rng().uniform(80, 120, 9))
    assert ratio_interval(times, times[::-1]) == ratio_interval(times, times[::-1])
