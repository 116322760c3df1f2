"""Chosen views: in free space, around the scene's own camera, repeatable."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest

import pathtrace.region.neighbourhood as module
from compose.base.errors import UserError
from compose.camera.camera import Camera, View
from pathtrace.region.neighbourhood import Neighbourhood, choose_views, unseen_views, views_beyond, wider
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.scene.triangles import Surfaces
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


@pytest.fixture(scope="module")
def ball(backend) -> tuple[Scene, Surfaces]:
    """A camera in the middle of a closed sphere of radius 3, far from everything."""
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, 1, 0])
    description = small.furnace()
    description["sensor"]["to_world"] = look
    scene = load_scene(description)
    return scene, scene.surfaces()


@pytest.fixture(scope="module")
def screened(backend) -> tuple[Scene, Surfaces]:
    """The same with a small screen behind the camera, which hides places that are free otherwise."""
    description = small.furnace()
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, 1, 0])
    description["sensor"]["to_world"] = look
    screen = mi.ScalarTransform4f().translate([0.12, 0, -0.12]).rotate([0, 1, 0], 135).scale(0.1)
    scene = load_scene({**description, "screen": {"type": "rectangle", "to_world": screen}})
    return scene, scene.surfaces()


@pytest.fixture(scope="module")
def room(backend) -> tuple[Scene, Surfaces]:
    scene = load_scene("room")
    return scene, scene.surfaces()


def keys(views: list[Camera]) -> list[bytes]:
    return [view.key for view in views]


def turns(home: Camera, views: list[Camera]) -> np.ndarray:
    """(N, 2) degrees of yaw and pitch from the home camera's axes."""
    forward = np.array([home.world_to_camera[:3, :3] @ view.camera_to_world[:3, 2] for view in views])
    yaw = np.degrees(np.arctan2(forward[:, 0], forward[:, 2]))
    return np.stack([yaw, np.degrees(np.arcsin(forward[:, 1]))], axis=1)


def test_the_scenes_own_camera_comes_first(room):
    scene, surfaces = room
    views = choose_views(scene, surfaces, 24, 32, 40, seed=1)
    assert views.fixed[0].key == scene.camera.resized(32, 40).key
    assert len(views.fixed) + len(views.spread) == 24
    assert {(view.width, view.height) for view in views.fixed + views.spread} == {(32, 40)}


@pytest.mark.parametrize("place", ["room", "screened"])
def test_views_stand_in_free_space(place, request):
    scene, surfaces = request.getfixturevalue(place)
    spread = choose_views(scene, surfaces, 80, 32, 32, seed=1).spread
    scale = surfaces.median_distance(scene.camera)
    for view in spread:
        assert surfaces.sees(scene.camera.position, view.position)
        assert surfaces.clearance(view.position) >= 0.02 * scale
        assert 0 < np.linalg.norm(view.position - scene.camera.position) <= 0.12 * scale * 1.01
        # Not with a tenth of the frame full of something near.
        assert np.mean(surfaces.probe(view) < 0.15 * scale) <= 0.1


def test_views_are_spread_evenly_in_a_ball_and_over_directions(ball):
    """Where everything is free: no view is refused."""
    scene, surfaces = ball
    spread = choose_views(scene, surfaces, 16 + 1, 32, 32, seed=3).spread
    spread = spread + choose_views(scene, surfaces, 400, 32, 32, seed=3).spread
    reach = 0.12 * surfaces.median_distance(scene.camera)
    offsets = np.array([view.position for view in spread]) / reach
    radius = np.linalg.norm(offsets, axis=1)
    assert radius.max() <= 1 + 1e-6
    # Half of a ball's volume lies within 0.794 of its radius.
    assert np.mean(radius < 0.794) == pytest.approx(0.5, abs=0.05)
    np.testing.assert_allclose(offsets.mean(axis=0), 0, atol=0.05)
    found = turns(scene.camera, spread)
    assert (np.abs(found).max(axis=0) <= [20, 10]).all()
    np.testing.assert_allclose(
        np.quantile(found, [0.25, 0.5, 0.75], axis=0).T, [[-10, 0, 10], [-5, 0, 5]], atol=1
    )


def test_views_keep_the_horizon(ball):
    """The x axis of every view is level: yaw turns about the home camera's upward axis."""
    scene, surfaces = ball
    for view in choose_views(scene, surfaces, 17, 32, 32, seed=3).spread:
        assert view.camera_to_world[1, 0] == pytest.approx(0, abs=1e-6)
        rotation = view.world_to_camera[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
        assert np.linalg.det(rotation) == pytest.approx(1)


def test_larger_sets_have_views_turned_to_the_border(ball):
    """All eight pairs of -32, 0 and 32 degrees of yaw and -16, 0 and 16 of pitch, but for straight ahead."""
    scene, surfaces = ball
    assert len(choose_views(scene, surfaces, 16, 32, 32, seed=0).fixed) == 1
    fixed = choose_views(scene, surfaces, 17, 32, 32, seed=0).fixed
    assert all(np.array_equal(view.position, scene.camera.position) for view in fixed)
    found = sorted(map(tuple, turns(scene.camera, fixed[1:]).round(3).tolist()))
    assert found == [(x, y) for x in (-32, 0, 32) for y in (-16, 0, 16) if (x, y) != (0, 0)]


def test_the_same_seed_gives_the_same_views(room):
    scene, surfaces = room
    first, again, other = (choose_views(scene, surfaces, 6, 32, 32, seed).spread for seed in (1, 1, 2))
    assert keys(first) == keys(again)
    assert not set(keys(first)) & set(keys(other))


def test_views_are_those_of_earlier_versions(ball):
    """Frame sets that were begun with an earlier version must be resumable; values of the first version."""
    scene, surfaces = ball
    first, second = choose_views(scene, surfaces, 3, 32, 32, seed=1).spread
    for view, position, forward in (
        (first, [-0.0671, -0.1290, -0.1394], [-0.0682, 0.0826, 0.9942]),
        (second, [-0.1529, 0.2399, 0.0921], [0.1306, -0.0125, 0.9914]),
    ):
        np.testing.assert_allclose(view.position, position, atol=1e-4)
        np.testing.assert_allclose(view.camera_to_world[:3, 2], forward, atol=1e-4)


def test_unseen_views_are_no_training_views(room):
    scene, surfaces = room
    unseen = unseen_views(scene, 3, 32, 32)
    assert keys(unseen) == keys(unseen_views(scene, 3, 32, 32))
    assert len(unseen) == 3
    for seed in range(3):
        views = choose_views(scene, surfaces, 20, 32, 32, seed)
        assert not set(keys(unseen)) & set(keys(views.fixed + views.spread))


def test_views_beyond_are_outside_the_neighbourhood_and_away_from_training_views(room):
    scene, surfaces = room
    around = Neighbourhood(scene, surfaces, 32, 32)
    found = views_beyond(scene, [], 6, 32, 32)
    assert len(found) == 6
    assert keys(found) == keys(views_beyond(scene, [], 6, 32, 32))
    distances = [np.linalg.norm(view.camera.position - around.home.position) for view in found]
    assert around.radius * 1.5 <= min(distances)
    assert max(distances) <= around.radius * 2.5
    # A forest that was trained at the first of them knows what is near it.
    others = views_beyond(scene, [found[0].camera], 6, 32, 32)
    assert found[0].key not in keys(others)
    away = [np.linalg.norm(view.camera.position - found[0].camera.position) for view in others]
    assert min(away) > around.radius / 2


def test_there_are_no_views_beyond_where_training_was_everywhere(room, monkeypatch):
    scene, surfaces = room
    monkeypatch.setattr(module, "_TRIES_PER_VIEW", 20)
    around = Neighbourhood(scene, surfaces, 32, 32)
    everywhere = np.stack(np.meshgrid(*[np.arange(-3, 3.1, 0.25)] * 3), axis=-1).reshape(-1, 3)
    assert around.beyond(2, around.home.position + everywhere * around.radius, 0) == []


@pytest.mark.parametrize("fov", [10.0, 60.0, 100.0, 150.0])
def test_wider_views_see_more_up_to_a_bound(room, fov):
    scene, _ = room
    camera = scene.camera.resized(48, 32)
    focal = 24 / np.tan(np.radians(fov) / 2)
    view = View(replace(camera, fx=focal, fy=focal), 0.25)
    wide = wider(view)
    assert wide.time == 0.25
    np.testing.assert_array_equal(wide.camera.world_to_camera, camera.world_to_camera)
    assert wide.camera.fx / wide.camera.fy == pytest.approx(1)
    half = 24 / wide.camera.fx
    assert half == pytest.approx(max(24 / focal, min(1.6 * 24 / focal, 2.0)))


def test_more_views_than_fit_are_refused(room, monkeypatch):
    """Nowhere in the room is a surface farther away than ten times what the camera sees."""
    monkeypatch.setattr(module, "_CLEARANCE", 10.0)
    monkeypatch.setattr(module, "_TRIES_PER_VIEW", 5)
    with pytest.raises(UserError, match=r"^room: only 0 of 19 further views fit into the free space"):
        choose_views(*room, 20, 16, 16, seed=0)


def test_views_full_of_near_surfaces_are_refused(ball, monkeypatch):
    """Everything in the ball counts as near, and half of the frame may show it."""
    monkeypatch.setattr(module, "_NEAR", 2.0)
    monkeypatch.setattr(module, "_NEAR_SHARE", 0.5)
    monkeypatch.setattr(module, "_TRIES_PER_VIEW", 5)
    with pytest.raises(UserError, match="only 0 of 3 further views"):
        choose_views(*ball, 4, 16, 16, seed=0)
    monkeypatch.setattr(module, "_NEAR_SHARE", 1.0)
    assert len(choose_views(*ball, 4, 16, 16, seed=0).spread) == 3


def test_a_camera_that_sees_nothing_is_refused():
    scene = load_scene({"type": "scene", "sensor": small.sensor(), "sky": {"type": "constant"}})
    with pytest.raises(UserError, match="the scene's own camera sees no surface"):
        choose_views(scene, scene.surfaces(), 4, 16, 16, seed=0)
