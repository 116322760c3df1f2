"""Which views come how often."""

from __future__ import annotations

import numpy as np
import pytest

from splat.training.layer_training import order_of_views


def visits(errors: list[float], rounds: int = 4000) -> np.ndarray:
    """(V,) mean visits per round."""
    rng = np.random.default_rng(3)
    orders = [order_of_views(np.array(errors), rng) for _ in range(rounds)]
    assert all(len(order) == len(errors) for order in orders)
    return np.bincount(np.concatenate(orders), minlength=len(errors)) / rounds


@pytest.mark.parametrize("errors", [[np.nan] * 5, [0.2] * 5, [0.0] * 5])
def test_views_that_are_equally_wrong_come_once_each(errors):
    rng = np.random.default_rng(0)
    orders = [order_of_views(np.array(errors), rng) for _ in range(30)]
    assert all(sorted(order) == [0, 1, 2, 3, 4] for order in orders)
    assert len({tuple(order) for order in orders}) > 15


def test_visits_are_in_proportion_to_the_error_and_a_floor():
    # A mean of 2, of which a quarter is the floor: shares of 4.5, 2.5, 0.5 and 2.5.
    np.testing.assert_allclose(visits([4.0, 2.0, 0.0, np.nan]), [1.8, 1.0, 0.2, 1.0], atol=0.02)


def test_visits_in_one_round_differ_from_that_by_less_than_one():
    errors = np.random.default_rng(1).random(40)
    expected = (errors + 0.25 * errors.mean()) / (1.25 * errors.mean())
    for seed in range(20):
        found = np.bincount(order_of_views(errors, np.random.default_rng(seed)), minlength=40)
        assert (np.abs(found - expected) < 1 + 1e-9).all()


def test_one_view_comes_again_and_again():
    assert order_of_views(np.array([0.3]), np.random.default_rng(0)).tolist() == [0]
