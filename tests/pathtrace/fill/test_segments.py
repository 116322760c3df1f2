"""Segments beyond the cache, and that paths of each length get just the light that they would have traced."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pathtrace.fill.filling import fill_cache, segments_beyond_cache
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
REFLECTANCE = 0.5


@pytest.fixture(scope="module")
def furnace(backend) -> Scene:
    return load_scene(small.furnace(REFLECTANCE))


@pytest.mark.parametrize(
    ("depth", "segments"), [(-1, -1), (0, 1), (1, 1), (2, 1), (3, 1), (4, 2), (5, 3), (65, 63)]
)
def test_two_segments_lead_to_the_cache_and_at_least_one_beyond(depth, segments, furnace):
    assert segments_beyond_cache(replace(furnace, max_depth=depth)) == segments


@pytest.mark.parametrize("depth", [3, 5, -1])
def test_the_cache_adds_what_is_missing_in_a_closed_sphere(depth, furnace):
    """Its wall emits 1 - rho: radiance is a geometric series, of one member for each segment."""
    scene = replace(furnace, max_depth=depth)
    cache = fill_cache(scene, [scene.camera], points=1 << 12)
    assert len(cache.cells) > 50
    tracer = Tracer(scene, cache=cache)
    radiance = interleaved(tracer.trace(scene.camera, frame_positions(scene.camera), 64).radiance)
    expected = 1 - REFLECTANCE**depth if depth > 0 else 1.0
    assert radiance.mean() == pytest.approx(expected, rel=0.003)
