"""What regions and scenes take."""

from __future__ import annotations

import pytest

from hybrid.plan.needs import Needs


@pytest.mark.parametrize(("complexity", "least", "most"), [(0.0, 0.5, 0.7), (1.0, 1.0, 1.0), (2.2, 1.2, 1.7)])
def test_gaussians_of_empty_and_of_busy_scenes_are_bounded(complexity, least, most):
    """All blocks of a frame can show detail, which is 2.2 times as many as in `room`."""
    assert least <= Needs.of(1.0, complexity).gaussians <= most


def test_broad_regions_take_more_gaussians_but_not_as_many_times_more():
    plain, broad = Needs.of(1.0, 0.8), Needs.of(4.0, 0.8)
    assert plain.gaussians < broad.gaussians < 4 * plain.gaussians


@pytest.mark.parametrize("breadth", [1.0, 3.0])
def test_needs_of_so_many_gaussians_take_them(breadth):
    assert Needs.of_gaussians(breadth, 0.7).gaussians == pytest.approx(0.7)
