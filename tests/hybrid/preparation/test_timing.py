"""How long stages take, and which fit in the time that is left."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from hybrid.base.journal import Journal
from hybrid.preparation.stage_planner import (
    AS_EXPECTED,
    PROBED,
    JobClock,
    Planner,
    Seconds,
    affordable_steps,
    expected_seconds,
    next_stage,
    step_seconds,
)
from hybrid.preparation.stages import STAGES, Needs, PreparationSettings

STAGE, BEFORE = STAGES[1], STAGES[:1]
SECONDS = expected_seconds(STAGE, BEFORE).at(AS_EXPECTED)


def test_a_stage_for_which_little_time_is_left_is_shorter_or_left_out():
    half = next_stage(BEFORE, Needs(), AS_EXPECTED, 0.6 * SECONDS)
    assert half is not None
    assert 0.3 * STAGE.steps < half.steps < 0.6 * STAGE.steps
    assert expected_seconds(half, BEFORE).at(AS_EXPECTED) == pytest.approx(0.6 * SECONDS, rel=0.02)
    assert next_stage(BEFORE, Needs(), AS_EXPECTED, 0.1) is None


def test_the_first_stage_has_fewer_steps_before_it_has_fewer_views():
    whole = expected_seconds(STAGES[0], [])
    assert next_stage([], Needs(), AS_EXPECTED, None) == STAGES[0]
    some = next_stage([], Needs(), AS_EXPECTED, 0.8 * whole.at(AS_EXPECTED))
    assert some is not None
    assert some.views == STAGES[0].views
    assert 0.3 * STAGES[0].steps < some.steps < 0.8 * STAGES[0].steps
    assert expected_seconds(some, []).at(AS_EXPECTED) == pytest.approx(0.8 * whole.at(AS_EXPECTED), rel=0.02)
    few = next_stage([], Needs(), AS_EXPECTED, 0.6 * whole.at(AS_EXPECTED))
    assert few is not None
    assert (few.steps, few.gaussians) == (40, STAGES[0].gaussians)
    assert 8 < few.views < STAGES[0].views
    least = next_stage([], Needs(), AS_EXPECTED, -5.0)
    assert least is not None
    assert (least.views, least.steps) == (8, 40)


def test_where_no_further_stage_fits_the_last_one_goes_on():
    """With views and steps of its kind; not with few steps, which would make the forest worse."""
    before = list(STAGES[:3])
    left = 0.25 * expected_seconds(STAGES[3], before).at(AS_EXPECTED)
    rest = next_stage(before, Needs(), AS_EXPECTED, left)
    assert rest is not None
    assert rest.is_rest
    assert (rest.scale, rest.spp, rest.gaussians) == (STAGES[2].scale, STAGES[2].spp, STAGES[2].gaussians)
    assert rest.steps >= 150
    assert expected_seconds(rest, before).at(AS_EXPECTED) == pytest.approx(left, rel=0.05)
    # It is none of the stages: what comes after it is what would have come instead.
    assert next_stage([*before, rest], Needs(), AS_EXPECTED, 1e6) == STAGES[3]
    assert next_stage(before, Needs(), AS_EXPECTED, 0.3 * left) is None


def test_a_stage_is_stretched_over_time_in_which_no_further_one_fits():
    following = expected_seconds(STAGES[2], [*BEFORE, STAGE]).at(AS_EXPECTED)
    longer = next_stage(BEFORE, Needs(), AS_EXPECTED, SECONDS + 0.2 * following)
    assert longer is not None
    assert longer.steps > STAGE.steps
    assert longer.views > STAGE.views
    assert longer.gaussians == STAGE.gaussians
    assert expected_seconds(longer, BEFORE).at(AS_EXPECTED) == pytest.approx(
        SECONDS + 0.2 * following, rel=0.02
    )
    assert next_stage(BEFORE, Needs(), AS_EXPECTED, SECONDS + 0.8 * following) == STAGE


def test_where_frames_take_longer_than_expected_there_are_fewer_and_steps_keep_their_share():
    """Further samples of earlier views take as long however short the stage is."""
    slow = Seconds(3.0, 1.0)
    stage, before = STAGES[4], STAGES[:4]
    left = 0.8 * expected_seconds(stage, before).at(slow)
    shorter = next_stage(before, Needs(), slow, left)
    assert shorter is not None
    frames_done = left - slow.frames * expected_seconds(shorter, before).frames
    assert affordable_steps(shorter, before, frames_done, slow) == pytest.approx(shorter.steps, rel=0.02)


def test_steps_cost_what_a_view_shows():
    """In a broad region most Gaussians are elsewhere."""
    for stage in STAGES:
        broad = stage.for_needs(Needs(12.0))
        assert broad.gaussians > 5 * stage.gaussians
        assert step_seconds(broad) == pytest.approx(step_seconds(stage), rel=0.15)


@pytest.mark.parametrize(
    ("number", "frames", "training"),
    [(0, 7.2, 7.0), (1, 15.5, 27), (3, 45, 86)],
    ids=["first", "second", "fine"],
)
def test_a_stage_is_expected_to_take_what_it_took(number, frames, training):
    """On the machine that this was measured on.

    The third stage is left out: it takes less where further samples do not pay, which is not known before.
    """
    expected = expected_seconds(STAGES[number], STAGES[:number])
    assert expected.frames == pytest.approx(frames, rel=0.2)
    assert expected.training == pytest.approx(training, rel=0.2)


def test_samples_that_views_have_already_are_not_traced_again():
    again = replace(STAGES[2], views=0, steps=0)
    assert expected_seconds(again, STAGES[:3]).frames == 0


def test_steps_fit_in_the_time_that_frames_have_left():
    steps = affordable_steps(STAGE, BEFORE, 30.0, AS_EXPECTED)
    training = expected_seconds(replace(STAGE, steps=steps), BEFORE).training
    assert training == pytest.approx(30, rel=0.01) or steps == STAGE.steps
    assert affordable_steps(STAGE, BEFORE, 15.0, Seconds(1.0, 0.5)) == steps
    assert affordable_steps(STAGE, BEFORE, 1e6, AS_EXPECTED) == STAGE.steps
    assert affordable_steps(STAGE, BEFORE, -5, AS_EXPECTED) == STAGE.steps / 10
    assert affordable_steps(STAGES[0], [], -5, AS_EXPECTED) == 40


def begun(path, minutes: float | None, spent: float) -> Planner:
    """A planner in the first stage of a job that began some seconds ago."""
    settings, journal = PreparationSettings(minutes=minutes), Journal(path, {"name": "a job"})
    planner = Planner(settings, journal, JobClock(journal, time.perf_counter() - spent), Needs())
    assert planner.begin([])
    return planner


def test_the_first_views_tell_how_large_the_first_stage_can_be(tmp_path):
    planner = begun(tmp_path / "job", 0.6, 10.0)
    assert planner.is_to_fit
    planner.fit_first(PROBED * 1.0)
    fitted = planner.stages[0]
    # A view takes a second, so that not all of them fit into 26 seconds, and hardly a step beside them.
    assert 8 <= fitted.views < 26
    assert fitted.steps == 40
    assert not planner.is_to_fit
    # What was decided holds in the next run.
    again = begun(tmp_path / "job", 0.6, 10.0)
    assert not again.is_to_fit
    assert again.stages == [fitted]


def test_without_a_limit_nothing_is_fitted(tmp_path):
    planner = begun(tmp_path / "job", None, 10.0)
    assert not planner.is_to_fit
    assert planner.paced is None
    assert planner.steps() == STAGES[0].steps


@pytest.mark.parametrize(
    ("seconds", "least", "most"),
    [(0.1, 95, 105), (0.01, 140, 140), (9.0, 40, 40)],
    ids=["fits", "leaves-time-for-more", "hardly-fits"],
)
def test_the_first_steps_tell_how_many_fit(tmp_path, seconds, least, most):
    """In about ten seconds; where another stage fits afterwards, there are no more than planned."""
    planner = begun(tmp_path / "job", 1.0, 48.0)
    assert planner.steps() == 140
    assert planner.paced is not None
    found = planner.paced(seconds)
    assert least <= found <= most
    assert planner.steps() == found
    assert planner.paced is None
