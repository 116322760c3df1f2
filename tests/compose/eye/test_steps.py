"""The steps in which detail falls."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from compose.eye.acuity import COARSEST_RATE, Step, detail_steps


def pairs(steps: tuple[Step, ...]) -> list[tuple[int, int]]:
    return [(step.layer, step.rate) for step in steps]


def test_the_steps_of_fov_gs_on_paper():
    """Cut-off 0.25 at the edge; the layers' own pixels are 1, 2, 4 and 8 display pixels.

    Level boundaries lie at 0.25, 0.125 and 0.0625 cycles per pixel: 2, 3 and 4 octaves. There samples of
    2, 4 and 8 pixels carry what is left.
    """
    steps = detail_steps(0.25, 0.25, (3, 2, 1, 0), 1, 0.22)
    assert pairs(steps) == [(4, 0), (3, 1), (2, 2), (1, 3), (1, 4)]
    assert steps[0].octaves == -np.inf
    np.testing.assert_allclose([step.octaves + 0.22 for step in steps[1:4]], [2, 3, 4])
    assert steps[4].octaves == 5


def test_one_layer_still_loses_samples():
    steps = detail_steps(0.25, 0.25, (0,), 1, 0.22)
    assert pairs(steps) == [(1, rate) for rate in range(COARSEST_RATE + 1)]
    assert [step.octaves for step in steps[1:]] == [2, 3, 4, 5]


def test_the_finest_layer_loses_samples_before_the_next_one_begins():
    """Needed up to 1/32 cycle per pixel, 5 octaves: the rates of 2 and 4 pixels begin at 2 and 3 octaves.

    The rate of 8 pixels would begin at 4 octaves and end at 4.5, just before the next layer begins.
    """
    steps = detail_steps(1 / 32, 1 / 32, (3, 0), 1, 0.5)
    assert pairs(steps) == [(2, 0), (2, 1), (2, 2), (2, 3), (1, 4)]
    assert [step.octaves for step in steps[1:]] == [2, 3, 4, 4.5]
    narrow = detail_steps(1 / 31.9, 1 / 31.9, (3, 0), 1, 0.5)
    assert pairs(narrow)[:4] == [(2, 0), (2, 1), (2, 2), (1, 3)]


def test_boundaries_follow_the_gaze_and_rates_do_not():
    straight = detail_steps(0.25, 0.25, (3, 2, 1, 0), 1, 0.22)
    aside = detail_steps(0.2, 0.25, (3, 2, 1, 0), 1, 0.22)
    assert pairs(aside) == pairs(straight)
    shift = [b.octaves - a.octaves for a, b in zip(straight[1:4], aside[1:4], strict=True)]
    np.testing.assert_allclose(shift, np.log2(0.25 / 0.2))


def test_no_rate_is_finer_than_worth_its_samples():
    steps = detail_steps(0.25, 0.25, (4, 3, 3, 2), 1, 0.22)
    assert pairs(steps) == [(4, 2), (3, 3), (2, 3), (1, 4)]


def test_layers_below_the_lowest_are_not_drawn():
    steps = detail_steps(0.25, 0.25, (3, 2, 1, 0), 3, 0.22)
    assert pairs(steps) == [(4, 0), (3, 1), (3, 2), (3, 3), (3, 4)]
    np.testing.assert_allclose([step.octaves for step in steps[1:]], [1.78, 3, 4, 5])


def test_a_step_does_not_begin_before_the_last_one_has_faded_in():
    """Layer 1 begins at 3.5 octaves with the rate of 2 pixels; its next rate waits for the fade to end."""
    steps = detail_steps(1 / 16, 0.25, (0, 0), 1, 0.5)
    assert pairs(steps)[:3] == [(2, 0), (1, 1), (1, 2)]
    assert [step.octaves for step in steps[1:3]] == [3.5, 4.0]


def test_every_rate_of_the_coarsest_layer_waits_for_the_fade_before():
    """Layers begin at 3.5 and 4.5 octaves; the rates of 8 and 16 pixels would begin at 4 and 5."""
    steps = detail_steps(1 / 16, 0.25, (0, 0, 0), 1, 0.5)
    assert pairs(steps) == [(3, 0), (2, 1), (1, 2), (1, 3), (1, 4)]
    assert [step.octaves for step in steps[1:]] == [3.5, 4.5, 5, 5.5]


@pytest.mark.parametrize("finest", [0.5, 0.3, 0.1, 0.02])
@pytest.mark.parametrize("rates", [(0,), (1, 0), (4, 3, 2, 1), (0, 0, 0)])
def test_steps_only_get_coarser(finest, rates):
    steps = detail_steps(finest, finest, rates, 1, 0.22)
    for one, next_one in pairwise(steps):
        assert next_one.octaves > one.octaves
        assert next_one.layer <= one.layer
        assert next_one.rate >= one.rate
        assert (next_one.layer, next_one.rate) != (one.layer, one.rate)
    assert steps[-1].rate == COARSEST_RATE
    assert steps[-1].layer == 1
