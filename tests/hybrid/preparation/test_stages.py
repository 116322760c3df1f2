"""Stages in regions of any breadth."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hybrid.plan.needs import Needs
from hybrid.preparation.stages import STAGES, planned_stage


@pytest.mark.parametrize("stage", STAGES)
def test_the_default_region_has_the_stages_as_they_are_described(stage):
    assert stage.of_breadth(1.0) == stage


@pytest.mark.parametrize("breadth", [1.5, 4.0, 12.0])
@pytest.mark.parametrize("stage", STAGES)
def test_broad_regions_have_more_views_of_no_more_samples_in_all(stage, breadth):
    broad = stage.of_breadth(breadth)
    assert broad.views == round(stage.views * breadth)
    assert stage.gaussians < broad.gaussians < stage.gaussians * breadth
    assert broad.steps > stage.steps
    assert 4 <= broad.spp_at(stage.scale) <= stage.spp_at(stage.scale)
    assert broad.spp_at(1) <= stage.spp_at(1)


def test_after_the_last_stage_samples_double():
    assert [planned_stage(number, Needs()) for number in range(len(STAGES))] == list(STAGES)
    assert planned_stage(len(STAGES), Needs()).spp == 2 * STAGES[-1].spp


@pytest.mark.parametrize("stage", STAGES)
def test_simple_scenes_have_fewer_gaussians_and_nothing_else_less(stage):
    simple, plain = stage.for_needs(Needs(complexity=0.4)), stage.for_needs(Needs())
    assert 0.4 * plain.gaussians < simple.gaussians < 0.7 * plain.gaussians
    assert replace(simple, gaussians=plain.gaussians) == plain == stage


@pytest.mark.parametrize(("complexity", "least", "most"), [(0.0, 0.2, 0.3), (2.2, 1.2, 1.7)])
def test_gaussians_of_empty_and_of_busy_scenes_are_bounded(complexity, least, most):
    """All blocks of a frame can show detail, which is 2.2 times as many as in `room`."""
    found = STAGES[2].for_needs(Needs(complexity=complexity)).gaussians
    assert least < found / STAGES[2].gaussians < most
