"""Stages in regions of any breadth, and in the time that is left."""

from __future__ import annotations

import pytest

from hybrid.preparation.stages import STAGES, next_stage


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
    for scale in (1, 2, 4):
        assert 4 <= broad.spp_at(scale) <= stage.spp_at(scale)


def test_a_stage_for_which_little_time_is_left_is_shorter_or_left_out():
    stage = STAGES[1]
    half = next_stage(1, 1.0, 1.0, stage.seconds / 2)
    assert half is not None
    assert half.steps == stage.steps / 2
    assert next_stage(1, 1.0, 1.0, stage.seconds / 10) is None
    assert next_stage(0, 1.0, 1.0, 0.0) == STAGES[0]


def test_after_the_last_stage_samples_double():
    further = next_stage(len(STAGES), 1.0, 1.0, None)
    assert further is not None
    assert further.spp == 2 * STAGES[-1].spp
