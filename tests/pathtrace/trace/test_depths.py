"""Radiance by the length of paths."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.path_depths import MOST_SEGMENTS, DepthShares, depth_shares, path_costs
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.pathtrace.trace.test_cached_paths import room

pytestmark = pytest.mark.usefixtures("backend")


@pytest.mark.parametrize("albedo", [0.2, 0.8])
def test_in_a_furnace_each_bounce_brings_its_albedo(albedo: float):
    """Of a radiance of 1, paths of d segments bring (1 - albedo) albedo^(d - 1)."""
    scene = load_scene(small.furnace(albedo))
    found = depth_shares(scene, [scene.camera], 1 << 15, 0)
    expected = (1 - albedo) * albedo ** np.arange(12)
    np.testing.assert_allclose(found.radiance.mean(axis=0)[:12], expected, rtol=0.05, atol=2e-4)
    np.testing.assert_allclose(found.shares.sum(), 1)


def test_the_sum_is_the_radiance_that_mitsuba_finds():
    """Of depths up to five, against its own paths."""
    scene = load_scene(room({"roughplastic": {"type": "roughplastic", "alpha": 0.3}}))
    found = depth_shares(scene, [scene.camera], 1 << 18, 1)
    parts = found.radiance[:, :5].sum(axis=1)
    tracer, positions = Tracer(scene.at_depth(5)), frame_positions(scene.camera)
    weights = [0.212671, 0.715160, 0.072169]
    images = [
        interleaved(tracer.trace(scene.camera, positions, 128, seed).radiance).mean(axis=0) @ weights
        for seed in range(8)
    ]
    error = np.hypot(np.std(images) / np.sqrt(7), parts.std(ddof=1) / np.sqrt(len(parts)))
    assert parts.mean() == pytest.approx(np.mean(images), abs=5 * error)


def test_the_depth_is_the_least_that_leaves_less_than_a_share():
    radiance = np.zeros((4, MOST_SEGMENTS))
    radiance[:, :4] = [0.5, 0.3, 0.19, 0.01]
    shares = DepthShares(radiance)
    assert shares.beyond(3) == pytest.approx(0.01)
    assert shares.error_beyond(3) == pytest.approx(0, abs=1e-12)
    assert [shares.depth_for(share) for share in (0.02, 0.005, 0.6)] == [3, 4, 1]
    noisy = DepthShares(
        radiance + np.array([0, 0.01, -0.005, 0.002])[:, None] * (np.arange(MOST_SEGMENTS) == 3)
    )
    assert noisy.depth_for(0.0115) == 4


def test_without_light_every_depth_is_enough():
    dark = DepthShares(np.zeros((4, MOST_SEGMENTS)))
    assert dark.depth_for(0.005) == 1
    assert dark.shares.tolist() == [0.0] * MOST_SEGMENTS


def test_the_same_seed_gives_the_same():
    scene = load_scene(small.corner())
    a, b, c = (depth_shares(scene, [scene.camera], 1 << 10, seed).radiance for seed in (3, 3, 4))
    np.testing.assert_allclose(a, b, rtol=1e-6)
    assert not np.allclose(a, c)


def test_paths_of_several_bounds_are_counted_apart():
    """In a furnace all paths are as long as they may be; and those of two views are counted together."""
    scene = load_scene(small.furnace(0.5))
    cameras = [scene.camera, scene.camera.resized(7, 5)]
    costs = path_costs(scene, cameras, 256, [(2, 99), (5, 99), (1, 99)], 0)
    assert [cost.segments for cost in costs] == [2, 5, 1]
    # What is seen of the furnace itself is the same everywhere.
    assert costs[2].variance == pytest.approx(0, abs=1e-12)
