"""Irradiance over time, against what the path tracer finds on a white floor."""

from __future__ import annotations

import json

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.cells import Points
from pathtrace.fill.filling import fill_cache
from pathtrace.fill.gather import irradiance_over_time
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from tests import small

REFLECTANCE = 0.6
NONE = np.zeros(0, dtype=np.int64)


@pytest.fixture(scope="module")
def scene(backend, tmp_path_factory) -> Scene:
    """A wall, and a board that goes past between it and a lamp."""
    square = {
        "type": "rectangle",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": REFLECTANCE}},
    }
    facing = mi.ScalarTransform4f().rotate([0, 1, 0], 180)
    board = mi.ScalarTransform4f().translate([-3, 0, 0.5]) @ facing.scale(0.4)
    file = tmp_path_factory.mktemp("scene") / "any.motion.json"
    track = {"keyframes": [{"t": 0}, {"t": 1, "translate": [6, 0, 0]}]}
    file.write_text(json.dumps({"shapes": {"board": track}}))
    description = {
        "type": "scene",
        "sensor": small.sensor(24, 24),
        "wall": {**square, "to_world": mi.ScalarTransform4f().translate([0, 0, 2]) @ facing.scale(3)},
        "board": {**square, "to_world": board},
        "lamp": {"type": "point", "position": [0, 0, -1.5], "intensity": {"type": "rgb", "value": 20.0}},
    }
    return load_scene(description, motion=file)


def test_irradiance_follows_a_shadow_that_moves(scene):
    """The wall sees nothing that reflects but the board."""
    scene.set_time(0.0)
    cache = fill_cache(scene, [scene.camera], points=1 << 12)
    x = np.linspace(-1.5, 1.5, 31, dtype=np.float32)
    place = np.stack([x, np.full_like(x, 0.05), np.full_like(x, 2)], axis=1)
    points = Points(place, np.tile(np.float32([0, 0, -1]), (len(x), 1)))
    times = [0.0, 0.45, 0.5, 0.6]
    found = irradiance_over_time(scene, cache, lambda time: points, NONE, times, 3)
    assert found.shape == (4, 3, 31)
    np.testing.assert_allclose(found, np.repeat(found[:, :1], 3, axis=1), rtol=1e-5)
    found = found[:, 0]
    way = place - [0, 0, -1.5]
    exact = 20 * way[:, 2] / np.linalg.norm(way, axis=1) ** 3
    np.testing.assert_allclose(found[0], exact, rtol=0.02)
    for row, time in zip(found, times, strict=True):
        # Seen from the lamp, the board's shadow on the wall is 3.5 / 2 as large as it.
        middle = (6 * time - 3) * 1.75
        inside, outside = np.abs(x - middle) < 0.65, np.abs(x - middle) > 0.75
        assert (row[inside] < 0.1 * exact[inside]).all()
        np.testing.assert_allclose(row[outside], exact[outside], rtol=0.15)


def test_the_same_seed_gives_the_same_irradiance(scene):
    cache = fill_cache(scene, [scene.camera], points=1 << 10)
    camera = scene.camera
    scene.set_time(0.0)
    hits = Tracer(scene).hits(camera, frame_positions(camera))
    seen = np.isfinite(hits.distance)
    place = camera.position + camera.rays(camera.pixel_centres())[seen] * hits.distance[seen, None]
    points = Points(place.astype(np.float32), np.tile(np.float32([0, 0, -1]), (seen.sum(), 1)))
    one, other = (
        irradiance_over_time(scene, cache, lambda time: points, NONE, [0.2, 0.8], 5) for _ in range(2)
    )
    np.testing.assert_array_equal(one, other)
    assert np.isfinite(one).all()
    assert (one >= 0).all()


def test_points_that_move_have_the_light_where_they_are(scene):
    """On both sides of the board, of which the lamp lights one."""
    scene.set_time(0.0)
    cache = fill_cache(scene, [scene.camera], points=1 << 12)
    y = np.linspace(-0.3, 0.3, 7, dtype=np.float32)

    def points(time: float) -> Points:
        x = np.full_like(y, 6 * time - 3)
        front, back = (np.stack([x, y, np.full_like(y, z)], axis=1) for z in (0.499, 0.501))
        normals = np.repeat(np.float32([[0, 0, -1], [0, 0, 1]]), 7, axis=0)
        return Points(np.concatenate([front, back]), normals)

    times = [0.1, 0.3, 0.5]
    found = irradiance_over_time(scene, cache, points, np.arange(14), times, 3)[:, 1]
    for row, time in zip(found, times, strict=True):
        way = points(time).position[:7] - [0, 0, -1.5]
        exact = 20 * way[:, 2] / np.linalg.norm(way, axis=1) ** 3
        np.testing.assert_allclose(row[:7], exact, rtol=0.02)
    # The wall sees so little that its cache knows nothing of it.
    np.testing.assert_array_equal(found[:, 7:], 0)
