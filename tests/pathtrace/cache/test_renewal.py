"""Light that is renewed part by part: exact in the end, and right on average before."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.fill.relight import Renewal
from tests import small

PLACES, REGIONS, SAMPLES = 40, 4, 10
REGION = np.arange(PLACES) % REGIONS
NUMBERS = np.full(PLACES, SAMPLES)


def old_sums() -> np.ndarray:
    return SAMPLES * small.rng().uniform(0.5, 2, (PLACES, 3))


def test_without_new_samples_the_old_light_is_known():
    np.testing.assert_allclose(Renewal(old_sums(), NUMBERS, REGION).sums(), old_sums(), rtol=4e-3)


def test_when_all_samples_are_new_nothing_old_is_left():
    renewal = Renewal(1000 * old_sums(), NUMBERS, REGION)
    light = small.rng(1).uniform(size=(PLACES * SAMPLES, 3))
    places = small.rng(2).permutation(np.repeat(np.arange(PLACES), SAMPLES))
    renewal.add(places[:100], light[:100])
    renewal.add(places[100:], light[100:])
    expected = [light[places == place].sum(axis=0) for place in range(PLACES)]
    np.testing.assert_allclose(renewal.sums(), expected, rtol=1e-6)


@pytest.mark.parametrize("factor", [0.0, 0.5, 30.0])
def test_a_change_by_a_factor_is_known_from_a_few_samples(factor):
    renewal = Renewal(old_sums(), NUMBERS, REGION)
    places = np.arange(0, PLACES, 3)
    renewal.add(places, factor * old_sums()[places] / SAMPLES)
    np.testing.assert_allclose(renewal.sums(), factor * old_sums(), rtol=3e-3)


def test_each_region_changes_by_itself_once_it_has_samples():
    factor = np.array([1.0, 0.5, 2.0, 0.0])[REGION][:, None]
    renewal = Renewal(old_sums(), NUMBERS, REGION)
    places = np.repeat(np.arange(PLACES), SAMPLES - 1)
    renewal.add(places, (factor * old_sums() / SAMPLES)[places])
    # The samples of other regions count a little, for the tenth that is not sampled yet.
    np.testing.assert_allclose(renewal.sums(), factor * old_sums(), rtol=0.02, atol=0.02 * SAMPLES)


def test_a_light_that_is_switched_on_is_even_at_first():
    renewal = Renewal(np.zeros((PLACES, 3)), NUMBERS, REGION)
    assert (renewal.sums() < 1e-9).all()
    renewal.add(np.arange(PLACES), np.tile([1.0, 2.0, 0.0], (PLACES, 1)))
    np.testing.assert_allclose(renewal.sums(), SAMPLES * np.tile([1.0, 2.0, 0.0], (PLACES, 1)), atol=1e-6)


def test_a_further_change_starts_from_what_is_known():
    renewal = Renewal(old_sums(), NUMBERS, REGION)
    places = np.arange(PLACES)
    renewal.add(places, 0.5 * old_sums() / SAMPLES)
    again = renewal.again()
    np.testing.assert_allclose(again.sums(), renewal.sums(), rtol=4e-3)
    again.add(places, old_sums() / SAMPLES)
    np.testing.assert_allclose(again.sums(), old_sums(), rtol=5e-3)


def test_there_may_be_no_places():
    nothing = np.zeros(0, dtype=np.int64)
    renewal = Renewal(np.zeros((0, 3)), nothing, nothing)
    renewal.add(nothing, np.zeros((0, 3), dtype=np.float32))
    assert renewal.sums().shape == (0, 3)
