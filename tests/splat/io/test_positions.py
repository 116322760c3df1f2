"""Positions come back within their tolerance, for scenes of any size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from splat.io.compact import boxed, tolerance, unboxed
from tests.extremes import extreme

coordinates = st.floats(width=32, allow_nan=False, allow_infinity=False)


def _cloud(n: int, seed: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(3, n)).astype(np.float32).astype(np.float64)


def _rounded(exact: np.ndarray) -> np.ndarray:
    """What float32 itself loses."""
    return np.linalg.norm(np.abs(exact) * 2.0**-23 + 1e-45, axis=0)


@pytest.mark.parametrize(
    "scale",
    [
        pytest.param(
            s, marks=extreme(f"compact scene of {s:g} units", given="5,000 positions", expected="tolerated")
        )
        for s in (1e-4, 1.0, 1e6)
    ],
)
def test_positions_are_right_to_their_tolerance(scale, got):
    exact = (_cloud(5000) * scale).astype(np.float32).astype(np.float64)
    tolerated = scale * np.logspace(-6, -2, 5000)
    boxes = boxed(exact, tolerated, (2000, 3000))
    error = np.linalg.norm(unboxed(boxes).astype(np.float32) - exact, axis=0)
    assert (error <= tolerated + _rounded(exact)).all()
    got((error / tolerated).max(), ".2f")


def test_no_box_holds_nodes_of_two_layers():
    boxes = boxed(_cloud(700), np.ones(700), (300, 0, 400))
    ends = np.cumsum(boxes.counts)
    assert 300 in ends
    assert boxes.counts.max() <= 256


def test_what_is_far_away_does_not_coarsen_what_is_near():
    """The sky's nodes may lie between those of a room; boxes are halved until they hold one kind."""
    exact = _cloud(256)
    exact[:, 100] = 2.0**17
    boxes = boxed(exact, np.full(256, 1e-4), (256,))
    assert np.abs(unboxed(boxes) - exact).max() < 1e-4
    assert 2 < len(boxes.counts) < 20


def test_a_single_node_and_nodes_at_one_place_are_exact():
    for exact in (_cloud(1), np.repeat(_cloud(1), 999, axis=1)):
        boxes = boxed(exact, np.zeros(exact.shape[1]), (exact.shape[1],))
        np.testing.assert_array_equal(unboxed(boxes), exact)


def test_no_nodes_have_no_boxes():
    assert unboxed(boxed(np.zeros((3, 0)), np.zeros(0), (0,))).shape == (3, 0)


def test_flat_nodes_tolerate_a_share_of_their_width():
    found = tolerance(np.log([[1.0, 1.0], [2.0, 1.0], [4.0, 1e-9]]))
    np.testing.assert_allclose(found, [1 / 16, 1 / 1024])


@given(
    means=st.integers(1, 40).flatmap(lambda n: arrays(np.float32, (3, n), elements=coordinates)),
    size=st.floats(1e-30, 1e30),
)
@settings(max_examples=200, deadline=None)
def test_any_positions_are_stored_once_and_for_all(means, size):
    exact = means.astype(np.float64)
    tolerated = np.full(means.shape[1], size)
    layers = (means.shape[1],)
    once = unboxed(boxed(exact, tolerated, layers)).astype(np.float32)
    assert np.isfinite(once).all()
    error = np.linalg.norm(once.astype(np.float64) - exact, axis=0)
    assert (error <= size + _rounded(exact)).all()
    twice = unboxed(boxed(once.astype(np.float64), tolerated, layers)).astype(np.float32)
    np.testing.assert_array_equal(twice, once)


@pytest.mark.parametrize("counts", [[5, 4], [10, 0], [11, -1], []])
def test_boxes_that_do_not_hold_all_are_refused(counts):
    boxes = boxed(_cloud(10), np.ones(10), (10,))
    with pytest.raises(ValueError, match="do not hold all"):
        unboxed(replace(boxes, counts=np.array(counts, np.int32)))
