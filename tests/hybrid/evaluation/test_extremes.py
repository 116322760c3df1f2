"""Choices and the controller at the ends: nothing to choose from, and times that are none."""

from __future__ import annotations

import math

import pytest

from compose.base.errors import UserError
from hybrid.evaluation.measured_settings import MeasuredSettings, chosen, pareto_front
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.frame_loop import FrameTimeController
from tests.extremes import extreme

LADDER = [MeasuredSettings(FrameSettings(spp=spp), 10.0 * spp, float(spp)) for spp in (1, 2, 4)]


@extreme(
    "Pareto front with NaN and ties",
    given="points of which some have no time or no quality, and equal ones, in two orders",
    expected="the front of the others, the first of equal ones",
)
def test_points_that_are_no_numbers_are_not_on_the_front(got):
    nan, points = math.nan, [(3.0, 5.0), (1.0, 1.0), (2.0, 4.0), (2.0, 4.0), (4.0, 5.0)]
    broken = [(nan, 9.0), (0.5, nan), (nan, nan)]
    mixed = [broken[0], points[0], broken[1], *points[1:3], broken[2], *points[3:]]
    for order in (mixed, mixed[::-1]):
        assert got(pareto_front(order, lambda one: one)) == [(1, 1), (2, 4), (3, 5)]
    assert pareto_front(broken, lambda one: one) == []


@extreme(
    "choice among no settings",
    given="nothing was measured",
    expected="refused, with the command that measures",
)
def test_nothing_can_be_chosen_of_nothing(got):
    with pytest.raises(UserError, match="no settings have been measured") as refused:
        chosen("jod", [], 10.0, None)
    got(str(refused.value))


@extreme(
    "measured settings without a number",
    given="a time of 0, NaN or infinity, a quality of NaN",
    expected="refused: a choice could not compare them",
)
def test_settings_need_a_time_and_a_quality(got):
    for milliseconds, quality in ((0.0, 9.0), (math.nan, 9.0), (math.inf, 9.0), (-1.0, 9.0), (1.0, math.nan)):
        with pytest.raises(ValueError, match="must be finite, the time above 0") as refused:
            MeasuredSettings(FrameSettings(), milliseconds, quality)
    got(str(refused.value))


@pytest.mark.parametrize(
    "milliseconds",
    [
        pytest.param(
            value,
            marks=extreme(
                f"controller with times of {value:g} ms",
                given=f"20,000 frames of {value:g} ms, then 300 of the time that was measured",
                expected=expected,
            ),
        )
        for value, expected in (
            (0.0, "a finite load above 0; afterwards the settings of before"),
            (1e9, "the fastest settings; afterwards the settings of before"),
            (math.inf, "no change"),
            (math.nan, "no change"),
        )
    ],
)
def test_the_controller_survives_any_time(milliseconds, got):
    controller = FrameTimeController(LADDER, 25.0)
    before = controller.choice()
    for _ in range(20_000):
        controller.took(milliseconds)
    assert 0 < got(controller.load, ".3g") < math.inf
    if milliseconds == 1e9:
        assert controller.choice() == LADDER[0]
    if not math.isfinite(milliseconds):
        assert (controller.load, controller.choice()) == (1.0, before)
    for _ in range(300):
        controller.took(controller.choice().milliseconds)
    assert controller.load == pytest.approx(1, abs=0.01)
    assert controller.choice().milliseconds == pytest.approx(before.milliseconds, rel=0.01)


@pytest.mark.parametrize("target", [0.0, -1.0, math.nan])
def test_a_target_that_is_no_time_is_refused(target):
    with pytest.raises(ValueError, match="must be positive"):
        FrameTimeController(LADDER, target)
