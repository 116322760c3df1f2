"""Samplers against the formulas of the specification, written out."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.gltf.animated_nodes import Sampler
from tests.pathtrace.gltf.building import quaternion

TIMES = np.array([0.5, 1.0, 3.0])
VALUES = np.array([[1.0, -2.0], [3.0, 0.0], [-1.0, 5.0]])


def test_linear_values_are_between_their_keyframes_and_constant_beyond():
    sampler = Sampler(TIMES, VALUES, "LINEAR", False)
    wanted = [VALUES[0], VALUES[0], (VALUES[0] + VALUES[1]) / 2, (3 * VALUES[1] + VALUES[2]) / 4, VALUES[2]]
    np.testing.assert_allclose(sampler.at(np.array([0, 0.5, 0.75, 1.5, 9])), wanted, atol=1e-14)


def test_steps_hold_until_the_next_keyframe():
    sampler = Sampler(TIMES, VALUES, "STEP", False)
    found = sampler.at(np.array([0, 0.999, 1.0, 2.999, 3.0, 9]))
    np.testing.assert_array_equal(found, VALUES[[0, 0, 1, 1, 2, 2]])


def test_cubic_splines_are_hermite_polynomials_with_tangents_per_second():
    rng = np.random.default_rng(0)
    triples = rng.normal(size=(3, 3, 2))
    sampler = Sampler(TIMES, triples, "CUBICSPLINE", False)
    for time in (0.5, 0.6, 1.0, 2.2, 2.9, 3.0):
        k = 0 if time < 1 else 1
        span = TIMES[k + 1] - TIMES[k]
        t = (time - TIMES[k]) / span
        wanted = (
            (2 * t**3 - 3 * t**2 + 1) * triples[k, 1]
            + span * (t**3 - 2 * t**2 + t) * triples[k, 2]
            + (-2 * t**3 + 3 * t**2) * triples[k + 1, 1]
            + span * (t**3 - t**2) * triples[k + 1, 0]
        )
        np.testing.assert_allclose(sampler.at(np.array([time]))[0], wanted, atol=1e-13)
    for beyond, key in ((0.0, 0), (7.0, 2)):
        np.testing.assert_allclose(sampler.at(np.array([beyond]))[0], triples[key, 1], atol=1e-13)


def test_quaternions_turn_the_shorter_way_at_a_constant_speed():
    start, end = np.array(quaternion((1, 2, 0), 10)), np.array(quaternion((0, 1, 1), 130))
    angle = np.arccos(abs(start @ end))
    for sign in (1, -1):
        sampler = Sampler(np.array([0.0, 2.0]), np.stack([start, sign * end]), "LINEAR", True)
        for u in (0.0, 0.3, 0.9, 1.0):
            near = end * np.sign(start @ end)
            wanted = (np.sin((1 - u) * angle) * start + np.sin(u * angle) * near) / np.sin(angle)
            (found,) = sampler.at(np.array([2 * u]))
            assert abs(found @ wanted) == pytest.approx(1, abs=1e-13)


def test_quaternions_of_splines_are_made_unit():
    triples = np.zeros((2, 3, 4))
    triples[:, 1] = quaternion((0, 0, 1), 0), quaternion((0, 0, 1), 90)
    (found,) = Sampler(np.array([0.0, 1.0]), triples, "CUBICSPLINE", True).at(np.array([0.5]))
    mean = triples[:, 1].mean(axis=0)
    np.testing.assert_allclose(found, mean / np.linalg.norm(mean), atol=1e-14)


@pytest.mark.parametrize("interpolation", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_a_single_keyframe_holds_for_ever(interpolation):
    values = np.full((1, 3, 2), 7.0) if interpolation == "CUBICSPLINE" else np.full((1, 2), 7.0)
    sampler = Sampler(np.array([1.0]), values, interpolation, False)
    np.testing.assert_array_equal(sampler.at(np.array([0.0, 1.0, 5.0])), np.full((3, 2), 7.0))


@pytest.mark.parametrize(
    ("times", "values", "rotation", "said"),
    [
        ([0, 1], [[1.0]], False, "2 times for 1 values"),
        ([0, 0], [[1.0], [2.0]], False, "do not ascend"),
        ([1, 0], [[1.0], [2.0]], False, "do not ascend"),
        ([0], [[0.0, 0, 0, 0]], True, "without length"),
    ],
)
def test_what_is_no_sampler_is_refused(times, values, rotation, said):
    with pytest.raises(ValueError, match=said):
        Sampler(np.array(times, dtype=float), np.array(values), "LINEAR", rotation)
