"""Gaussians in other coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.camera.coordinate_systems import WORLD, Place, place_around
from splat.model.points import from_world, in_world, place_of_gaussians
from tests.extremes import extreme
from tests.splat.samples import equal, gaussians


def test_a_point_and_a_size_by_hand():
    """Place at (10, 20, 30) in units of 2: (1, 2, 3) is (12, 24, 36) in the world, a size of 1 is 2."""
    own = gaussians(n=1)
    own.means[:, 0], own.log_scales[:, 0] = torch.tensor([1.0, 2.0, 3.0]), 0.0
    place = Place((10.0, 20.0, 30.0), 2.0)
    world = in_world(own, place)
    assert world.means[:, 0].tolist() == [12, 24, 36]
    np.testing.assert_allclose(world.log_scales[:, 0].exp(), 2, rtol=1e-6)
    np.testing.assert_array_equal(place.in_world(np.array([[1.0, 2.0, 3.0]])), [[12, 24, 36]])
    assert equal(replace(from_world(world, place), log_scales=own.log_scales), own)


def test_the_world_changes_no_bit():
    some = gaussians()
    assert equal(in_world(some, WORLD), some)
    assert equal(from_world(some, WORLD), some)


def test_the_place_of_points_is_their_median():
    points = np.array([[1.0, 5, 0], [2, 6, 0], [3, 100, 0]])
    assert place_around(points, 8.0) == Place((2.0, 6.0, 0.0), 2.0)


@pytest.mark.parametrize(
    "bad", [((0.0, np.nan, 0.0), 1.0), ((0.0, 0.0, 0.0), 0.0), ((0.0, 0.0, 0.0), np.inf)]
)
def test_senseless_places_are_refused(bad):
    with pytest.raises(ValueError, match="must be finite, the unit positive"):
        Place(*bad)


@pytest.mark.parametrize(
    ("scale", "offset"),
    [
        pytest.param(s, o, marks=extreme(f"imported Gaussians {n}", given="no views known", expected=e))
        for s, o, n, e in [
            (1e-4, 0.0, "at a scale of 1e-4", "own coordinates of size 4"),
            (1e7, 0.0, "at a scale of 1e7", "own coordinates of size 4"),
            (1.0, 1e5, "1e5 from the origin", "own coordinates of size 4"),
        ]
    ],
)
def test_imported_gaussians_of_unusual_size_or_place_get_their_own_coordinates(scale, offset, got):
    some = gaussians(n=500)
    world = replace(
        some, means=some.means * scale + offset, log_scales=some.log_scales + float(np.log(scale))
    )
    own = from_world(world, place_of_gaussians(world))
    means = own.means.numpy()
    size = np.median(np.linalg.norm(means - np.median(means, axis=1, keepdims=True), axis=0))
    assert got(float(size), ".2f") == pytest.approx(4, rel=0.05)


def test_imported_gaussians_of_usual_size_stay_in_the_world():
    some = gaussians(n=500)
    for scale, offset in ((1.0, 0.0), (0.2, 1.0), (1e4, 0.0), (1.0, 100.0)):
        assert place_of_gaussians(replace(some, means=some.means * scale + offset)) == WORLD
    assert place_of_gaussians(gaussians(n=1)) == WORLD
