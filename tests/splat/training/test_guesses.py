"""Guesses of distances: from points, from what is not empty, from parallax."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.camera.camera import Camera, camera_from_pose, look_at
from splat.training.depth_estimates import focus, with_guesses
from splat.training.training_view import TrainingView
from tests.extremes import extreme
from tests.splat.training.frames import WALLS, made

UP = np.array([0.0, 1.0, 0.0])


def unknown(view: TrainingView) -> TrainingView:
    """A view of which nobody knows the distances."""
    return replace(view, distance=np.full_like(view.distance, np.nan), normal=np.zeros_like(view.normal))


def around_a_ball(angle: float) -> tuple[TrainingView, np.ndarray]:
    """A view of a ball of radius 1 at the origin, empty around it, and the true distances (H, W)."""
    position = 4 * np.array([np.sin(angle), 0.3 * np.cos(3 * angle), -np.cos(angle)])
    camera = camera_from_pose(look_at(position, np.zeros(3), UP), 32, 32, 40, 40, 16, 16)
    rays = camera.rays(camera.pixel_centres())
    b = rays @ camera.position
    root = b**2 - (camera.position @ camera.position - 1)
    exact = np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.inf)
    return made(camera, np.ones((32 * 32, 3)), exact, np.zeros(3, np.float32)), exact.reshape(32, 32)


def test_points_tell_the_distances_around_them():
    walls = [unknown(wall) for wall in WALLS]
    points = np.concatenate([wall.points(wall.surface_pixels[::5]) for wall in WALLS])
    for guessed, wall in zip(with_guesses(walls, points), WALLS, strict=True):
        assert guessed.guessed
        assert np.allclose(guessed.distance, wall.distance, rtol=0.03)
        assert np.allclose(
            guessed.normal.reshape(-1, 3), -wall.rays(np.arange(wall.distance.size)), atol=1e-6
        )


def test_points_behind_a_camera_tell_nothing():
    wall = unknown(WALLS[0])
    behind = wall.camera.position + np.array([[0.0, 0.0, -2.0], [0.1, 0.0, -3.0]])
    (guessed,) = with_guesses([wall], behind, (1.0, 5.0))
    assert (guessed.distance == 5).all()


def test_what_is_not_empty_has_the_distance_of_its_hull():
    views, exact = zip(*(around_a_ball(angle) for angle in np.linspace(0, 2 * np.pi, 13)[:-1]), strict=True)
    unknowns = [
        replace(view, distance=np.where(np.isinf(view.distance), np.inf, np.nan).astype(np.float32))
        for view in views
    ]
    for guessed, distance in zip(with_guesses(unknowns), exact, strict=True):
        shown = np.isfinite(distance)
        assert np.array_equal(np.isinf(guessed.distance), ~shown)
        # A hull of silhouettes lies before the ball, by less than it is large.
        error = guessed.distance[shown] - distance[shown]
        assert abs(np.median(error)) < 0.1
        assert np.abs(error).max() < 0.6


def test_parallax_tells_the_distance_of_a_textured_wall():
    rng = np.random.default_rng(0)
    texture = rng.uniform(size=(40, 40, 3))

    def view(x: float) -> TrainingView:
        wall = WALLS[1]
        camera = camera_from_pose(_moved(x), 64, 64, 80, 80, 32, 32)
        rays = camera.rays(camera.pixel_centres())
        points = camera.position + rays * (3 / rays[:, 2])[:, None]
        column, row = (np.clip((points[:, axis] + 3) * 6, 0, 39).astype(int) for axis in (0, 1))
        shape = (64, 64)
        return replace(
            wall,
            camera=camera,
            radiance=texture[row, column].reshape(*shape, 3).astype(np.float32),
            distance=np.full(shape, np.nan, np.float32),
            normal=np.zeros((*shape, 3), np.float32),
        )

    found = with_guesses([view(x) for x in np.linspace(-0.5, 0.5, 7)], None, (1.5, 6.0))
    exact = 3 / found[3].rays(np.arange(64 * 64))[:, 2].reshape(64, 64)
    error = np.abs(found[3].distance / exact - 1)[8:-8, 8:-8]
    assert np.median(error) < 0.05
    assert np.quantile(error, 0.9) < 0.2


def _moved(x: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = [x, 0, -3]
    return pose


def test_cameras_look_at_the_point_nearest_to_their_axes():
    target = np.array([0.3, -0.2, 1.0])
    cameras = [
        camera_from_pose(look_at(target + 2 * offset, target, UP), 8, 8, 8, 8, 4, 4)
        for offset in np.eye(3)[[0, 2]]
    ]
    point, distance = focus(cameras)
    assert point == pytest.approx(target)
    assert distance == pytest.approx(2)


@extreme(
    "cameras without a common target",
    given="one camera; two at one place; parallel axes; axes that part",
    expected="a finite point before them, at a positive distance",
)
def test_cameras_that_look_nowhere_in_common_get_a_point_before_them(got):
    def at(x: float, turn: float = 0.0) -> Camera:
        pose = look_at(np.array([x, 0, 0]), np.array([x + turn, 0.0, 1.0]), UP)
        return camera_from_pose(pose, 8, 8, 8, 8, 4, 4)

    for cameras in ([at(0)], [at(1), at(1)], [at(0), at(1), at(2)], [at(-1, -1), at(1, 1)]):
        point, distance = focus(cameras)
        assert np.isfinite(point).all()
        assert distance > 0
        assert point[2] > 0
    got("4 of 4")


@extreme(
    "guesses for hardly anything",
    given="no view; one view without points or bounds; two views of the same place; all of a frame empty",
    expected="finite distances, or inf where nothing is",
)
def test_guesses_are_numbers_for_any_views(got):
    assert with_guesses([]) == []
    wall = unknown(WALLS[0])
    empty = replace(wall, distance=np.full_like(wall.distance, np.inf))
    for views in ([wall], [wall, wall], [empty, empty], [empty, wall]):
        for view, found in zip(views, with_guesses(views), strict=True):
            assert (found.distance > 0).all()
            assert np.array_equal(np.isinf(found.distance), np.isinf(view.distance))
    got("5 of 5")
