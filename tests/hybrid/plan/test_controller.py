"""The controller meets its target, recovers from load, and does not jump about."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.plan.controller import FrameTimeController, Rung
from tests import small

LADDER = [Rung(5 + 3 * n, 1 + n // 3, 3 + (n > 1), 0, 0.5 if n < 2 else 1.0, 15 * 1.35**n) for n in range(8)]


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
        radii.append(controller.choice().fov_a)
    assert max(np.diff(radii)) < 0.5
    assert radii[-1] == pytest.approx(radii[20], rel=0.05)


def test_what_is_too_much_or_too_little_gives_the_ends():
    assert FrameTimeController(LADDER, 1.0).choice() == LADDER[0]
    assert FrameTimeController(LADDER, 1e6).choice() == LADDER[-1]
    with pytest.raises(ValueError, match="each slower"):
        FrameTimeController(LADDER[::-1], 10)
    with pytest.raises(ValueError, match="needs rungs"):
        FrameTimeController([], 10)
