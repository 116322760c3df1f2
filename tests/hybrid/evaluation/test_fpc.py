"""Figures of Foveated Path Culling, as its text sums them up."""

from __future__ import annotations

import pytest

from hybrid.evaluation.sweep_catalogue import (
    FPC_BREAK_EVEN,
    FPC_FIGURE_14,
    FPC_FIGURE_14_FULL,
    FPC_FIGURE_14_RADII,
    FPC_TABLE_4,
    FPC_TABLE_5,
    FPC_VIEW_SIZES,
)


def test_speed_ups_are_those_of_the_papers_text():
    """Table 4: 800x600 is 19.62 % slower, 3316x1061 is 43.31 % faster."""
    speed_ups = [ours / full - 1 for ours, full in FPC_TABLE_4.values()]
    assert speed_ups == pytest.approx([-0.1962, 0.2828, 0.3771, 0.4331], abs=0.002)
    speed_ups = [ours / full - 1 for ours, full in FPC_TABLE_5.values()]
    assert speed_ups == pytest.approx([-0.0185, 0.0667, 0.17, 0.2842], abs=0.002)


def test_tables_agree_where_they_show_the_same_size():
    assert FPC_TABLE_4[1012, 1061] == FPC_TABLE_5[1012, 1061]
    for width, height in FPC_TABLE_5:
        assert width / height == pytest.approx(1012 / 1061, abs=0.001)


def test_figures_that_sweeps_repeat_are_known():
    assert set(FPC_VIEW_SIZES) <= set(FPC_BREAK_EVEN)
    for by_radius in FPC_FIGURE_14.values():
        assert set(by_radius) <= set(FPC_FIGURE_14_RADII)
        assert by_radius[10] > by_radius[90]
    assert FPC_FIGURE_14[1][10] / FPC_FIGURE_14_FULL == pytest.approx(4 / 3)
