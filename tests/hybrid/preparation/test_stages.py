"""Stages in regions of any breadth."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hybrid.preparation.stages import STAGES, Needs, planned_stage


@pytest.mark.parametrize("stage", STAGES)
def test_the_default_region_has_the_stages_as_they_are_described(stage):
    assert stage.for_needs(Needs()) == stage


@pytest.mark.parametrize("breadth", [1.5, 4.0, 12.0])
@pytest.mark.parametrize("stage", STAGES)
def test_broad_regions_have_more_views_of_no_more_samples_in_all(stage, breadth):
    broad = stage.for_needs(Needs(breadth))
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
    simple, plain = stage.for_needs(Needs(detail=0.5)), stage.for_needs(Needs())
    assert simple.gaussians == round(0.5 * plain.gaussians)
    assert replace(simple, gaussians=plain.gaussians) == plain == stage
