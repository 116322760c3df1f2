"""What regions and scenes take."""

from __future__ import annotations

import pytest

from hybrid.preparation.decisions import FIXED_GAUSSIANS, GAUSSIANS, REGION, planned_needs
from hybrid.preparation.stages import Needs


def test_broad_regions_take_more_gaussians_but_not_as_many_times_more():
    plain, broad = Needs(1.0, 0.8), Needs(4.0, 0.8)
    assert plain.gaussians < broad.gaussians < 4 * plain.gaussians


@pytest.mark.parametrize(
    ("planned_for", "region", "gaussians"),
    [("near", "near", 0.7), ("reachable", "reachable", 0.7), ("near", "reachable", 0.7 * 3**0.7)],
)
def test_gaussians_are_those_of_the_plan(planned_for, region, gaussians):
    """Those of a plan for the default region grow with the region."""
    plan = {GAUSSIANS: round(0.7 * FIXED_GAUSSIANS), REGION: planned_for}
    breadth = 1.0 if region == "near" else 3.0
    found = planned_needs(plan, region, breadth)
    assert found.gaussians == pytest.approx(gaussians)
    assert found.breadth == breadth


def test_a_plan_for_another_region_tells_nothing():
    plan = {GAUSSIANS: 100, REGION: "reachable"}
    assert planned_needs(plan, "near", 1.0) == planned_needs({}, "near", 1.0) == Needs()
