"""What is free and what is visible, by Embree: spheres of known radius, and Mitsuba's own first hits."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from compose.camera.camera import sphere_directions
from pathtrace.scene.scene import load_scene
from pathtrace.scene.triangles import Surfaces
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
# Spheres are tessellated: at most 0.9 % of the radius inside.
TESSELLATION = 0.01


@pytest.fixture(scope="module")
def ball(backend) -> Surfaces:
    """Inside a sphere of radius 3."""
    return load_scene(small.furnace()).surfaces()


def facing_wall(width: float) -> dict:
    """A camera at the origin that looks along z, 90 degrees wide; a wall at z = 4 on one side of it."""
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, 1, 0])
    wall = mi.ScalarTransform4f().translate([width / 2, 0, 4]).scale([width / 2, 100, 1])
    return {
        "type": "scene",
        "sensor": {**small.sensor(32, 32, 90.0), "to_world": look},
        "wall": {"type": "rectangle", "to_world": wall},
        "lamp": {"type": "point"},
    }


def test_distances_in_a_ball(ball):
    directions = sphere_directions(50)
    assert ball.distance(np.zeros((50, 3)), directions).shape == (50,)
    np.testing.assert_allclose(ball.distance(np.zeros((50, 3)), directions), 3, rtol=TESSELLATION)
    aside = np.array([[2.0, 0, 0], [2.0, 0, 0]])
    found = ball.distance(aside, np.array([[1.0, 0, 0], [-1.0, 0, 0]]))
    np.testing.assert_allclose(found, [1, 5], rtol=0.03)


def test_rays_that_hit_nothing_are_infinite():
    surfaces = load_scene(facing_wall(4.0)).surfaces()
    directions = np.array([[0.0, 0, 1], [0.0, 0, -1], [-0.6, 0, 0.8]])
    found = surfaces.distance(np.array([[1.0, 0, 0]] * 3), directions)
    np.testing.assert_allclose(found, [4, np.inf, np.inf])


def test_clearance_is_the_distance_to_the_nearest_surface(ball):
    assert ball.clearance(np.zeros(3)) == pytest.approx(3, rel=TESSELLATION)
    for point in np.diag([2.0, 2.5, -2.0]):
        assert ball.clearance(point) == pytest.approx(3 - np.linalg.norm(point), rel=0.03)


def test_visibility_ends_at_surfaces(ball):
    assert ball.sees(np.zeros(3), np.array([1.0, 1, 1]))
    assert not ball.sees(np.zeros(3), np.array([4.0, 0, 0]))
    assert not ball.sees(np.array([4.0, 0, 0]), np.zeros(3))
    assert ball.sees(np.ones(3), np.ones(3))
    wall = load_scene(facing_wall(4.0)).surfaces()
    assert wall.sees(np.zeros(3), np.array([1.0, 0, 3.9]))
    assert not wall.sees(np.zeros(3), np.array([1.0, 0, 4.1]))


def test_embree_agrees_with_mitsuba_in_the_room():
    scene = load_scene("room")
    camera = scene.camera.resized(64, 64)
    expected = Tracer(scene).hits(camera, frame_positions(camera)).distance
    rays = camera.rays(camera.pixel_centres())
    found = scene.surfaces().distance(np.repeat(camera.position[None], len(rays), axis=0), rays)
    assert np.mean(np.isclose(found, expected, rtol=1e-3)) > 0.995


def test_the_median_distance_is_that_of_what_is_seen():
    """A wall at depth 4 on the right, nothing on the left: rays to it are 4 to 4 sqrt(3) long."""
    scene = load_scene(facing_wall(100.0))
    surfaces = scene.surfaces()
    distance = surfaces.probe(scene.camera).reshape(24, 24)
    seen = np.isfinite(distance)
    assert (seen.sum(axis=1) == 12).all()
    # Mitsuba's x axis points to the left of the image.
    assert seen[:, :12].all()
    x, y = np.meshgrid(*[(np.arange(24) + 0.5) / 12 - 1] * 2)
    expected = 4 * np.sqrt(1 + x**2 + y**2)
    np.testing.assert_allclose(distance[seen], expected[seen], rtol=1e-5)
    assert surfaces.median_distance(scene.camera) == pytest.approx(np.median(expected), rel=1e-5)


def test_a_camera_that_sees_nothing_has_no_median_distance():
    scene = load_scene({**facing_wall(4.0), "wall": {"type": "sphere", "center": [0, 0, -9]}})
    assert scene.surfaces().median_distance(scene.camera) == np.inf


def test_hits_have_normals_that_face_the_ray():
    surfaces = load_scene(facing_wall(4.0)).surfaces()
    np.testing.assert_allclose(surfaces.bounds, [[0, -100, 4], [4, 100, 4]], atol=1e-4)
    origins = np.array([[1.0, 0, 0], [1.0, 0, 9], [1.0, 0, 0]])
    distance, normal = surfaces.hits(origins, np.array([[0.0, 0, 1], [0, 0, -1], [0, 0, -1]]))
    np.testing.assert_allclose(distance, [4, 5, np.inf])
    np.testing.assert_allclose(normal, [[0, 0, -1], [0, 0, 1], [0, 0, 0]], atol=1e-6)


def test_many_points_are_as_one(ball):
    points = np.array([[0.0, 0, 0], [2, 0, 0], [0, 0, -2.5]])
    directions = sphere_directions(40)
    around = ball.around(points, directions)
    assert around.shape == (3, 40)
    np.testing.assert_array_equal(around[1], ball.distance(np.repeat(points[1:2], 40, axis=0), directions))
    np.testing.assert_array_equal(ball.clearances(points, 40), around.min(axis=1))
    ends = np.array([[1.0, 1, 1], [4, 0, 0], [0, 0, -2.5]])
    assert ball.are_joined(points, ends).tolist() == [True, False, True]
    assert ball.are_joined(points[:0], ends[:0]).shape == (0,)
    assert ball.around(points[:0], directions).shape == (0, 40)


def test_a_scene_without_triangles_is_empty(tmp_path):
    (tmp_path / "hair.txt").write_text("\n".join(f"{i} 0 0 0.1" for i in range(5)))
    curve = {"type": "bsplinecurve", "filename": str(tmp_path / "hair.txt")}
    surfaces = load_scene({**facing_wall(4.0), "wall": curve}).surfaces()

    assert surfaces.clearance(np.zeros(3)) == np.inf


def test_directions_are_even_over_the_sphere():
    directions = sphere_directions(256)
    assert directions.shape == (256, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    np.testing.assert_allclose(directions.mean(axis=0), 0, atol=0.01)
    assert directions[:, 2].mean() == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(directions.T @ directions / 256, np.eye(3) / 3, atol=0.01)
    # Each has its own place: an even spacing would be about 0.22.
    gaps = np.linalg.norm(directions[:, None] - directions, axis=-1) + 2 * np.eye(256)
    assert gaps.min() > 0.12


def test_of_instances_and_curves_mitsuba_says_what_is_hit(tmp_path):
    """A ball of radius 1 that is repeated on the right, and a straight curve on the left."""
    (tmp_path / "curve.txt").write_text("-3 -1 4 0.5\n-3 0 4 0.5\n-3 1 4 0.5\n-3 2 4 0.5\n")
    right = mi.ScalarTransform4f().translate([3, 0, 4])
    scene = {
        **{key: value for key, value in facing_wall(4.0).items() if key != "wall"},
        "group": {"type": "shapegroup", "ball": {"type": "sphere"}},
        "copy": {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": right},
        "curve": {"type": "bsplinecurve", "filename": str(tmp_path / "curve.txt")},
    }
    surfaces = load_scene(scene).surfaces()
    origins = np.array([[3.0, 0, 0], [-3.0, 0.5, 0], [0.0, 0, 0]])
    distance, normal = surfaces.hits(origins, np.tile([0.0, 0, 1], (3, 1)))
    np.testing.assert_allclose(distance, [3, 3.5, np.inf], atol=1e-3)
    np.testing.assert_allclose(normal, [[0, 0, -1], [0, 0, -1], [0, 0, 0]], atol=1e-3)
    np.testing.assert_array_equal(surfaces.distance(origins, np.tile([0.0, 0, 1], (3, 1))), distance)
    assert surfaces.bounds[0][0] < -3
    assert surfaces.bounds[1] == pytest.approx([4, 2, 5], abs=0.6)
