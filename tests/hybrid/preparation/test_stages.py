"""Stages in regions of any breadth, and in the time that is left."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hybrid.preparation.stages import STAGES, expected_seconds, next_stage


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


def test_a_stage_for_which_little_time_is_left_is_shorter_or_left_out():
    stage, before = STAGES[1], STAGES[:1]
    seconds = expected_seconds(stage, before)
    half = next_stage(before, 1.0, 1.0, seconds / 2)
    assert half is not None
    assert half.steps == stage.steps / 2
    assert next_stage(before, 1.0, 1.0, seconds / 10) is None
    assert next_stage([], 1.0, 1.0, 0.0) == STAGES[0]


def test_a_stage_is_stretched_over_time_in_which_no_further_one_fits():
    stage, before = STAGES[1], STAGES[:1]
    seconds = expected_seconds(stage, before)
    following = expected_seconds(STAGES[2], [*before, stage])
    longer = next_stage(before, 1.0, 1.0, seconds + 0.2 * following)
    assert longer is not None
    assert longer.steps == pytest.approx(stage.steps * (1 + 0.2 * following / seconds), abs=1)
    assert longer.views > stage.views
    assert longer.gaussians == stage.gaussians
    assert next_stage(before, 1.0, 1.0, seconds + 0.4 * following) == stage


def test_steps_cost_what_a_view_shows():
    """In a broad region most Gaussians are elsewhere."""
    for stage in STAGES:
        broad = stage.of_breadth(12.0)
        assert broad.gaussians > 5 * stage.gaussians
        assert broad.step_cost == pytest.approx(stage.step_cost, rel=0.15)


def test_after_the_last_stage_samples_double():
    further = next_stage(STAGES, 1.0, 1.0, None)
    assert further is not None
    assert further.spp == 2 * STAGES[-1].spp


def test_a_stage_is_expected_to_take_the_time_of_its_samples_and_steps():
    """On the machine that this was measured on; samples that views have already are not traced again.

    The third stage is left out: it takes less where further samples do not pay, which is not known before.
    """
    for stage, measured in ((STAGES[1], 42), (STAGES[3], 121)):
        before = STAGES[: STAGES.index(stage)]
        assert expected_seconds(stage, before) == pytest.approx(measured, rel=0.2)
    again = replace(STAGES[2], views=0, steps=0)
    assert expected_seconds(again, STAGES[:3]) == 0


def test_steps_fit_in_the_time_that_frames_have_left():
    last, stage = STAGES[1], STAGES[2]
    ratio = stage.step_cost / last.step_cost
    assert stage.affordable_steps(100 * ratio, last, 1.0) == pytest.approx(100, abs=1)
    assert stage.affordable_steps(1e6, last, 1.0) == stage.steps
    assert stage.affordable_steps(-5, last, 1.0) == stage.steps / 10
