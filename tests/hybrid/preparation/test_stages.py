"""Stages in regions of any breadth."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hybrid.preparation.stages import STAGES, Needs, Stage, going_on, planned_stage


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
    stages: list[Stage] = []
    for stage in STAGES:
        assert planned_stage(stages, Needs()) == stage
        stages.append(stage)
    assert planned_stage(stages, Needs()).spp == 2 * STAGES[-1].spp


def test_what_has_changed_is_learnt_between_the_stages():
    """In the frames that there are, with the Gaussians that there are; a little soon, then the rest."""
    changed = going_on(STAGES[:2], False, is_changed=True)
    for stage in changed:
        assert (stage.views, stage.gaussians, stage.scale) == (0, STAGES[1].gaussians, STAGES[1].scale)
    assert changed[0].steps < changed[1].steps
    assert planned_stage([*STAGES[:2], *changed], Needs()) == STAGES[2]
    assert going_on(STAGES[:2], False, is_changed=False) == []


def test_another_place_has_views_and_gaussians_of_its_own():
    second = going_on(STAGES[:2], True, is_changed=False)
    assert second[0].views < second[1].views
    for stage in second:
        assert STAGES[1].gaussians < stage.gaussians < 2 * STAGES[1].gaussians
    following = planned_stage([*STAGES[:2], *second], Needs())
    assert replace(following, gaussians=STAGES[2].gaussians) == STAGES[2]
    assert following.gaussians > STAGES[2].gaussians
    third = going_on([*STAGES[:2], *second], True, is_changed=True)
    assert second[0].gaussians < third[0].gaussians < 3 * STAGES[1].gaussians


@pytest.mark.parametrize("stage", STAGES)
def test_simple_scenes_have_fewer_gaussians_and_nothing_else_less(stage):
    simple, plain = stage.for_needs(Needs(detail=0.5)), stage.for_needs(Needs())
    assert simple.gaussians == round(0.5 * plain.gaussians)
    assert replace(simple, gaussians=plain.gaussians) == plain == stage
