"""How long stages take, and which fit in the time that is left."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from hybrid.base.identity import Journal
from hybrid.preparation.stage_planner import (
    AS_EXPECTED,
    BUILT,
    JUDGED,
    PROBED,
    JobClock,
    Planner,
    Seconds,
    affordable,
    expected_seconds,
    next_stage,
    step_seconds,
)
from hybrid.preparation.stages import FIRST_LOOK, STAGES, Needs, PreparationSettings, planned_stage

STAGE, BEFORE = STAGES[1], STAGES[:1]
SECONDS = expected_seconds(STAGE, BEFORE).at(AS_EXPECTED)


def test_a_stage_for_which_little_time_is_left_is_shorter_or_left_out():
    half = next_stage(BEFORE, Needs(), AS_EXPECTED, 0.6 * SECONDS)
    assert half is not None
    assert 0.3 * STAGE.steps < half.steps < 0.6 * STAGE.steps
    one_more = expected_seconds(replace(half, views=half.views + 1), BEFORE).at(AS_EXPECTED)
    assert expected_seconds(half, BEFORE).at(AS_EXPECTED) <= 0.6 * SECONDS < one_more
    assert next_stage(BEFORE, Needs(), AS_EXPECTED, 0.1) is None


def test_the_first_stage_has_fewer_samples_then_steps_and_then_views():
    whole = expected_seconds(STAGES[0], []).at(AS_EXPECTED)
    assert next_stage([], Needs(), AS_EXPECTED, None) == STAGES[0]
    noisy = next_stage([], Needs(), AS_EXPECTED, 0.95 * whole)
    assert noisy is not None
    assert 4 < noisy.spp < STAGES[0].spp
    assert replace(noisy, spp=STAGES[0].spp) == STAGES[0]
    some = next_stage([], Needs(), AS_EXPECTED, 0.8 * whole)
    assert some is not None
    assert (some.views, some.spp) == (STAGES[0].views, 4)
    assert 40 < some.steps < STAGES[0].steps
    assert expected_seconds(some, []).at(AS_EXPECTED) == pytest.approx(0.8 * whole, rel=0.02)
    few = next_stage([], Needs(), AS_EXPECTED, 0.5 * whole)
    assert few is not None
    assert (few.spp, few.steps, few.gaussians) == (4, 40, STAGES[0].gaussians)
    assert 12 <= few.views < STAGES[0].views


@pytest.mark.parametrize("breadth", [1.0, 3.0])
def test_a_first_look_is_the_least_that_is_done(breadth):
    needs = Needs(breadth)
    assert next_stage([], needs, AS_EXPECTED, -5.0) == FIRST_LOOK.for_needs(needs)


@pytest.mark.parametrize(("before", "longer"), [([], 1.6), (BEFORE, 1.3)], ids=["first", "second"])
def test_a_stage_is_stretched_over_time_in_which_no_further_one_fits(before, longer):
    """By samples and steps: both gain more than further views."""
    stage = STAGES[len(before)]
    left = longer * expected_seconds(stage, before).at(AS_EXPECTED)
    stretched = next_stage(before, Needs(), AS_EXPECTED, left)
    assert stretched is not None
    assert stretched.steps > stage.steps
    assert stretched.spp > stage.spp
    assert replace(stretched, spp=stage.spp, steps=stage.steps) == stage
    found = expected_seconds(stretched, before).at(AS_EXPECTED)
    # There is no part of a sample; what that leaves of the time, steps take when their pace is known.
    longer_still = replace(stretched, spp=stretched.spp + 1, steps=round(1.01 * stretched.steps))
    assert found <= left < expected_seconds(longer_still, before).at(AS_EXPECTED)
    following = expected_seconds(STAGES[len(before) + 1], [*before, stage]).at(AS_EXPECTED)
    assert next_stage(before, Needs(), AS_EXPECTED, left + following) == stage


@pytest.mark.parametrize("dear", [1.0, 2.0, 4.0])
def test_a_stretched_first_stage_leaves_time_for_its_training(dear):
    """Where paths are dear, there are fewer of them; never fewer than the stage has without stretching."""
    pace, stage = Seconds(dear, 1.0), planned_stage([], Needs(detail=2.0))
    left = 1.5 * expected_seconds(stage, []).at(pace)
    stretched = next_stage([], Needs(detail=2.0), pace, left)
    assert stretched is not None
    assert stretched.steps > stage.steps
    expected = expected_seconds(stretched, [])
    if stretched.spp > stage.spp:
        assert expected.frames * pace.frames <= expected.training * pace.training
    else:
        assert stretched.spp == stage.spp
    assert 0.9 * left < expected.at(pace) <= left


def test_where_no_further_stage_fits_the_last_one_goes_on():
    (last,) = BEFORE
    goes_on = next_stage(BEFORE, Needs(), AS_EXPECTED, 0.25 * SECONDS)
    assert goes_on is not None
    assert replace(goes_on, views=last.views, spp=last.spp, steps=last.steps) == last
    assert (goes_on.views, goes_on.steps > last.steps, goes_on.spp >= last.spp) == (0, True, True)
    assert expected_seconds(goes_on, BEFORE).at(AS_EXPECTED) <= 0.25 * SECONDS
    more = next_stage(BEFORE, Needs(), AS_EXPECTED, 0.33 * SECONDS)
    assert more is not None
    assert (more.views, more.steps > goes_on.steps, more.spp > last.spp) == (0, True, True)
    less = next_stage(BEFORE, Needs(), AS_EXPECTED, 0.13 * SECONDS)
    assert less is not None
    assert (less.views, less.spp, less.steps < last.steps) == (0, last.spp, True)


def test_where_frames_take_longer_than_expected_there_are_fewer_and_fewer_steps():
    """Further samples of earlier views take as long however short the stage is."""
    slow = Seconds(3.0, 1.0)
    stage, before = STAGES[4], STAGES[:4]
    left = 0.8 * expected_seconds(stage, before).at(slow)
    shorter = next_stage(before, Needs(), slow, left)
    assert shorter is not None
    assert shorter.views < 0.8 * stage.views
    assert shorter.steps / stage.steps == pytest.approx(shorter.views / stage.views, rel=0.02)
    assert expected_seconds(shorter, before).at(slow) == pytest.approx(left, rel=0.03)


def test_steps_cost_what_a_view_shows():
    """In a broad region most Gaussians are elsewhere."""
    for stage in STAGES:
        broad = stage.for_needs(Needs(12.0))
        assert broad.gaussians > 5 * stage.gaussians
        assert step_seconds(broad) == pytest.approx(step_seconds(stage), rel=0.15)


@pytest.mark.parametrize(
    ("number", "frames", "training"),
    [(0, 12.1, 10.2), (1, 26.9, 27.2), (2, 65.9, 66.0)],
    ids=["first", "second", "third"],
)
def test_a_stage_is_expected_to_take_what_it_took(number, frames, training):
    """In `room`, for which 67,800 Gaussians are planned, on the machine that this was measured on."""
    needs = Needs(detail=67_800 / STAGES[0].gaussians)
    stages = [planned_stage(STAGES[:one], needs) for one in range(number + 1)]
    expected = expected_seconds(stages[-1], stages[:-1])
    assert expected.frames == pytest.approx(frames, rel=0.1)
    assert expected.training == pytest.approx(training, rel=0.2)


def test_samples_that_views_have_already_are_not_traced_again():
    again = replace(STAGES[2], views=0, steps=0)
    assert expected_seconds(again, STAGES[:3]).frames == 0


def begun(path, minutes: float | None, spent: float, psnr: float | None = None) -> Planner:
    """A planner in the first stage of a job that began some seconds ago."""
    settings, journal = PreparationSettings(minutes=minutes, psnr=psnr), Journal(path, {"name": "a job"})
    planner = Planner(settings, journal, JobClock(journal, time.perf_counter() - spent), Needs())
    assert planner.begin([])
    return planner


def test_the_first_views_tell_how_large_the_first_stage_can_be(tmp_path):
    planner = begun(tmp_path / "job", 0.6, 10.0)
    assert planner.is_to_fit
    planner.fit_first(PROBED * 1.0)
    fitted = planner.stages[0]
    # A view takes a second, one with few samples less, and hardly a step fits into 26 seconds beside them.
    assert 8 <= fitted.views < 32
    assert (fitted.spp, fitted.steps) == (4, 40)
    assert not planner.is_to_fit
    # What was decided holds in the next run.
    again = begun(tmp_path / "job", 0.6, 10.0)
    assert not again.is_to_fit
    assert again.stages == [fitted]


def two_stages(needs: Needs) -> float:
    """Expected seconds of the first stage and of half of the second."""
    first = planned_stage([], needs)
    second = planned_stage([first], needs).in_time(0.5)
    return sum(expected_seconds(*of).at(AS_EXPECTED) for of in ((first, []), (second, [first])))


def test_a_scene_has_fewer_gaussians_where_that_leaves_time_for_a_second_stage():
    rich = Needs(breadth=1.5, detail=3.0)
    whole, half = two_stages(rich), two_stages(replace(rich, detail=1.5))
    assert affordable(rich, AS_EXPECTED, whole) == rich
    some = affordable(rich, AS_EXPECTED, (whole + half) / 2)
    assert 1.5 < some.detail < 3.0
    assert some.breadth == rich.breadth
    assert two_stages(some) <= (whole + half) / 2 < two_stages(replace(some, detail=1.12 * some.detail))
    assert affordable(rich, AS_EXPECTED, 1.001 * half).detail == pytest.approx(1.5)
    # With time for one stage only, it has all of them.
    assert affordable(rich, AS_EXPECTED, 0.99 * half) == rich


def test_the_number_of_gaussians_that_was_fitted_holds_in_the_next_run(tmp_path):
    probed = expected_seconds(replace(STAGES[0], views=PROBED), []).frames
    between = (two_stages(Needs(detail=2.0)) + two_stages(Needs(detail=1.0))) / 2
    settings = PreparationSettings(minutes=between / 60)

    def planner() -> Planner:
        journal = Journal(tmp_path / "job", {"name": "a job"})
        made = Planner(settings, journal, JobClock(journal, time.perf_counter()), Needs(detail=2.0))
        assert made.begin([])
        return made

    first = planner()
    share = first.fit_first(probed)
    assert 0.5 <= share < 1
    assert first.stages[0].gaussians == round(2 * share * STAGES[0].gaussians)
    again = planner()
    assert again.stages == first.stages
    assert again._needs == first._needs


def test_without_a_limit_nothing_is_fitted(tmp_path):
    planner = begun(tmp_path / "job", None, 10.0)
    assert not planner.is_to_fit
    assert planner.paced is None
    assert planner.steps() == STAGES[0].steps


@pytest.mark.parametrize(
    ("seconds", "least", "most"),
    [(0.4, 90, 100), (0.01, 150, 150), (9.0, 40, 40)],
    ids=["fits", "leaves-time-for-more", "hardly-fits"],
)
def test_the_first_steps_tell_how_many_fit(tmp_path, seconds, least, most):
    """In about 38 seconds; where another stage fits afterwards, there are no more than planned."""
    planner = begun(tmp_path / "job", 1.0, 20.0)
    assert planner.steps() == 150
    assert planner.paced is not None
    found = planner.paced(seconds, 0, 1)
    assert least <= found <= most
    assert planner.steps() == found


def test_later_steps_tell_again_how_many_fit(tmp_path):
    """In some 38 seconds after those that are done; at least as many as there can still be."""
    planner = begun(tmp_path / "job", 1.0, 20.0)
    assert planner.paced is not None
    assert 190 <= planner.paced(0.2, 8, 20) <= 200
    assert 105 <= planner.paced(0.5, 40, 100) <= 117
    assert planner.paced(4.0, 48, 120) == planner.steps() == 120


def test_steps_are_not_saved_for_a_stage_that_only_goes_on(tmp_path):
    """Of 17 seconds, 6 are planned; 11 are too few for further views."""
    planner = begun(tmp_path / "job", 1.0, 41.0)
    goes_on = next_stage(planner.stages, Needs(), AS_EXPECTED, 11.0)
    assert goes_on is not None
    assert goes_on.views == 0
    assert planner.paced is not None
    assert 400 <= planner.paced(0.04, 0, 1) <= 430


def test_steps_beyond_those_planned_save_no_time(tmp_path):
    """Further views take some 24 seconds, and 23 are left."""
    planner = begun(tmp_path / "job", 1.0, 34.2)
    assert planner.paced is not None
    assert 870 <= planner.paced(0.04, 300, 429) <= 895


@pytest.mark.parametrize("pace", [Seconds(1.0, 1.0), Seconds(3.0, 1.2), Seconds(0.2, 0.5)])
@pytest.mark.parametrize("minutes", [1.0, 2.0, 3.0, 5.0, 12.0, 30.0, 120.0])
def test_stages_use_the_time_and_no_more(tmp_path, monkeypatch, minutes, pace):
    """On a machine, in a scene, where frames and steps take other multiples of what is expected."""
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    journal = Journal(tmp_path / "job", {"name": "a job"})
    planner = Planner(PreparationSettings(minutes=minutes), journal, JobClock(journal, 0.0), Needs())
    while planner.begin([]):
        began, step = now[0], lambda: step_seconds(planner.stages[-1]) * pace.training
        if planner.is_to_fit:
            seconds = expected_seconds(replace(planner.stages[0], views=PROBED), []).frames * pace.frames
            now[0] += (1 + 1 / PROBED) * seconds
            planner.fit_first(seconds)
        expected = expected_seconds(planner.stages[-1], planner.stages[:-1])
        now[0] = began + expected.frames * pace.frames
        planner.lap("frame")
        planner.lap("light")
        assert planner.paced is not None
        # Trees are built after the steps, and all else before them.
        built = BUILT * planner.stages[-1].gaussians * pace.training if planner.number else 0.0
        now[0] += expected.training * pace.training - planner.stages[-1].steps * step() - built
        told = planner.paced(step(), 0, 1) // 3
        now[0] += told * step()
        later = 0.9 if planner.number else 1.0
        now[0] += (planner.paced(step(), told, 3 * told) - told) * later * step() + built
        planner.lap("training")
    now[0] += JUDGED * planner.stages[-1].gaussians * pace.training
    assert 0.9 < now[0] / (60 * minutes) <= 1.0


def test_a_quality_nearly_reached_is_tried_with_more_samples_first(tmp_path):
    """Once; a stage without further views is no reason to give up either."""
    planner = begun(tmp_path / "job", None, 0.0, psnr=35.0)
    curve = [{"psnr": 34.0}]
    assert planner.begin(curve)
    first = STAGES[0]
    assert planner.stages[-1] == replace(first, views=0, spp=2 * first.spp)
    curve.append({"psnr": 34.1})
    assert planner.begin(curve)
    assert planner.stages[-1] == STAGES[2]
    curve.append({"psnr": 34.5})
    assert planner.begin(curve)
    assert not planner.stages[-1].views
    curve.append({"psnr": 34.6})
    assert planner.begin(curve)
    assert planner.stages[-1].views
    assert not planner.begin([*curve, {"psnr": 34.7}])


def test_what_lacks_more_takes_more_samples_and_steps(tmp_path):
    planner = begun(tmp_path / "job", None, 0.0, psnr=35.0)
    assert planner.begin([{"psnr": 33.0}])
    first = STAGES[0]
    assert planner.stages[-1] == replace(first, views=0, spp=4 * first.spp, steps=2 * first.steps)


def test_a_quality_far_away_takes_the_next_stage(tmp_path):
    planner = begun(tmp_path / "job", None, 0.0, psnr=35.0)
    assert planner.begin([{"psnr": 32.9}])
    assert planner.stages == list(STAGES[:2])


def test_a_low_quality_begins_with_less_than_a_stage():
    less, *others = PreparationSettings(psnr=28.0).stages
    assert expected_seconds(less, []).at(AS_EXPECTED) < 0.8 * expected_seconds(STAGES[0], []).at(AS_EXPECTED)
    assert less.views == STAGES[0].views
    assert tuple(others) == STAGES
    assert PreparationSettings(psnr=31.0).stages == STAGES
