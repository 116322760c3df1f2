"""The controller meets its target, recovers from load, and changes settings smoothly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybrid.evaluation.measured_settings import MeasuredSettings
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.frame_loop import FrameTimeController, applied
from tests import small


def step(number: int) -> MeasuredSettings:
    """A step of a ladder of eight."""
    scale = 0.5 if number < 2 else 1.0
    settings = FrameSettings(spp=1 + number // 3, layers=(1, 3 + (number > 1)), scale=scale)
    return MeasuredSettings(settings.with_radius(5.0 + 3 * number), 15 * 1.35**number, float(number))


LADDER = [step(number) for number in range(8)]
# Three steps of 10, 20 and 40 ms with discs of 10, 20 and 20 %.
SHORT = [
    MeasuredSettings(FrameSettings(fov_a=fov_a, fov_b=fov_a / 2, spp=spp), milliseconds, float(spp))
    for fov_a, spp, milliseconds in ((10.0, 1, 10.0), (20.0, 2, 20.0), (20.0, 4, 40.0))
]


def simulate(controller: FrameTimeController, load: list[float]) -> np.ndarray:
    """Times of frames on a machine that takes `load` times what was measured, with noise of a twentieth."""
    rng = small.rng()
    times = []
    for factor in load:
        took = controller.choice().milliseconds * factor * rng.normal(1, 0.05)
        controller.took(took)
        times.append(took)
    return np.array(times)


@pytest.mark.parametrize("factor", [0.6, 1.0, 1.8])
def test_the_target_is_met_on_faster_and_slower_machines(factor):
    times = simulate(FrameTimeController(LADDER, 66.7), [factor] * 300)[60:]
    assert 0.8 * 66.7 < np.median(times) < 66.7
    assert np.mean(times < 1.2 * 66.7) > 0.95


def test_a_load_spike_is_over_two_seconds_after_it():
    load = [1.0] * 150 + [1.9] * 75 + [1.0] * 150
    times = simulate(FrameTimeController(LADDER, 66.7), load)
    # Frames that come early are held back elsewhere.
    within = times < 1.2 * 66.7
    assert within[30:150].mean() > 0.9
    # Within the spike frames are late for a moment only.
    assert (times[155:225] < 1.25 * 66.7).mean() > 0.95
    after = 225 + np.searchsorted(np.cumsum(times[225:]), 2000)
    assert within[after:].mean() > 0.9


def test_settings_change_smoothly_upwards():
    controller = FrameTimeController(LADDER, 66.7)
    radii = []
    for factor in [1.0] * 30 + [3.0] * 30 + [1.0] * 100:
        controller.took(controller.choice().milliseconds * factor)
        radii.append(controller.choice().settings.fov_a)
    assert max(np.diff(radii)) < 0.5
    assert radii[-1] == pytest.approx(radii[20], rel=0.05)


def test_a_target_out_of_reach_gives_the_ends_of_the_ladder():
    for target, end in ((1.0, LADDER[0]), (1e6, LADDER[-1])):
        choice = FrameTimeController(LADDER, target).choice()
        assert (choice.milliseconds, choice.quality) == (end.milliseconds, end.quality)
        assert choice.settings.fov_a == end.settings.fov_a
        assert choice.settings.fov_b == pytest.approx(end.settings.fov_b)


@pytest.mark.parametrize(
    ("target", "milliseconds", "fov_a", "spp"),
    [
        # 85 % of the target are planned.
        (10 / 0.85, 10, 10, 1),
        (15 / 0.85, 15, 15, 1),
        (17.5 / 0.85, 17.5, 17.5, 1),
        (20 / 0.85 + 1e-9, 20, 20, 2),
        # Where the radius does not grow, only the time does.
        (30 / 0.85, 30, 20, 2),
        (40 / 0.85 + 1e-9, 40, 20, 4),
    ],
)
def test_between_two_steps_radius_and_time_are_interpolated(target, milliseconds, fov_a, spp):
    choice = FrameTimeController(SHORT, target).choice()
    assert choice.milliseconds == pytest.approx(milliseconds)
    assert choice.settings.fov_a == pytest.approx(fov_a)
    assert choice.settings.fov_b == pytest.approx(fov_a / 2)
    assert choice.settings.spp == spp


def test_a_radius_never_shrinks_towards_the_next_step():
    shrinking = [SHORT[1], replace(SHORT[0], milliseconds=40.0)]
    choice = FrameTimeController(shrinking, 30 / 0.85).choice()
    assert (choice.settings.fov_a, choice.milliseconds) == (20, pytest.approx(30))


def test_the_load_rises_by_half_and_falls_by_a_twelfth_of_the_difference():
    controller = FrameTimeController(SHORT, 15 / 0.85)
    controller.took(30.0)
    assert controller.load == pytest.approx(1.5)
    # 15 ms are planned at a load of 1.5: the 10 ms of the first step.
    assert controller.choice().milliseconds == pytest.approx(10)
    assert controller.expected == pytest.approx(15)
    controller.took(10.0)
    assert controller.load == pytest.approx(1.5 - 0.08 * 0.5)


def test_one_outlier_counts_as_three_times_the_expected_time():
    outlier, slow = (FrameTimeController(SHORT, 15 / 0.85) for _ in range(2))
    outlier.took(1e6)
    slow.took(45.0)
    assert outlier.load == slow.load == pytest.approx(2)
    # Now 20 ms are expected of the first step, and 60 ms count at most: half-way from 2 to 6.
    outlier.took(1e6)
    assert outlier.load == pytest.approx(4)


def test_the_controller_climbs_an_eighth_of_a_step_per_frame_and_descends_at_once():
    controller = FrameTimeController(SHORT, 10 / 0.85)
    controller.target = 1000.0
    times = []
    for _ in range(17):
        controller.took(controller.choice().milliseconds)
        times.append(controller.choice().milliseconds)
    assert times[:3] == pytest.approx([11.2, 12.4, 13.6])
    # Beyond the second step, times grow by 20 ms per step.
    assert times[8:10] == pytest.approx([20 + 0.08 * 20, 20 + 0.2 * 20])
    assert times[-1] == 40
    controller.target = 10 / 0.85
    controller.took(40.0)
    assert controller.choice().milliseconds == pytest.approx(10)


def test_a_frame_is_not_expected_to_take_longer_than_the_target():
    controller = FrameTimeController(SHORT, 5.0)
    assert controller.expected == 5
    assert FrameTimeController(SHORT, 100.0).expected == pytest.approx(40)


def test_a_ladder_must_rise():
    with pytest.raises(ValueError, match="each slower"):
        FrameTimeController(LADDER[::-1], 10)
    with pytest.raises(ValueError, match="each slower"):
        FrameTimeController([LADDER[0], LADDER[0]], 10)
    with pytest.raises(ValueError, match="requires settings"):
        FrameTimeController([], 10)


def test_a_choice_replaces_what_was_measured_and_keeps_the_rest():
    requested = FrameSettings((0.2, 0.3), 20, 5, 3, "raw", "fov-gs", (2, 3), 1, 0.75, "hmd")
    settings = FrameSettings((0.9, 0.9), 40, 39, 8, "fused", "none", (1, 4), 2, 0.5, "desktop")
    found = applied(MeasuredSettings(settings, 10.0, 9.0), requested)
    assert found == replace(requested, fov_a=40, fov_b=10, spp=8, layers=(1, 4), rate=2, scale=0.5)
