"""Quaternions come back within their stated angle, and rounding twice changes nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from splat.io.compact import codes_of_rotations, rotations_of_codes

components = st.floats(width=32, allow_nan=False, allow_infinity=False)


def _stored(quaternions: np.ndarray) -> np.ndarray:
    return rotations_of_codes(*codes_of_rotations(np.asarray(quaternions, np.float64))).astype(np.float32)


def test_no_rotation_is_off_by_more_than_a_fifth_of_a_degree():
    exact = np.random.default_rng(3).normal(size=(4, 20_000)) * np.logspace(-20, 20, 20_000)
    exact[:, :100] = 1.0
    found = _stored(exact)
    first, second = (Rotation.from_quat(q.T.astype(np.float64)) for q in (exact, found))
    assert np.degrees((first.inv() * second).magnitude()).max() < 0.2
    # Signs, which mean nothing to a rotation, are those of before.
    assert ((exact * found).sum(axis=0) > 0).all()


@given(quaternion=st.lists(components, min_size=4, max_size=4))
@settings(max_examples=300, deadline=None)
def test_any_quaternion_is_stored_once_and_for_all(quaternion):
    once = _stored(np.array(quaternion)[:, None])
    assert np.abs(once).max() == 1
    np.testing.assert_array_equal(_stored(once), once)


@pytest.mark.parametrize("signs", [(1, 1, 1, 1), (-1, 1, -1, 1), (1, -1, 0, 0), (0, 0, -1, 1)])
def test_equally_large_components_are_exact(signs):
    np.testing.assert_array_equal(_stored(np.array(signs)[:, None])[:, 0], signs)


def test_nothing_turns_nothing():
    assert _stored(np.zeros((4, 1)))[:, 0].tolist() == [1, 0, 0, 0]
    assert _stored(np.zeros((4, 0))).shape == (4, 0)


@pytest.mark.parametrize(("largest", "other"), [(8, 0), (255, 0), (0, 512), (3, -32768)])
def test_codes_that_do_not_exist_are_refused(largest, other):
    with pytest.raises(ValueError, match="do not exist"):
        rotations_of_codes(np.array([largest], np.uint8), np.array([[0], [other], [0]], np.int16))
