"""Training views of the reachable region: repeatable, in order, and better than views at random."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.region import region_of
from pathtrace.region.view_coverage import ViewCoverage
from pathtrace.region.view_selection import looks_of, turned_about, upright, widened
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def keys(views):
    return [view.key for view in views]


def test_the_first_views_are_the_same_whatever_their_number(reachable, joined):
    scene, _ = joined
    many = reachable.views(30, 48, 32, seed=1)
    assert keys(reachable.views(7, 48, 32, seed=1)) == keys(many)[:7]
    assert many[0].key == scene.camera.resized(48, 32).key
    assert len(set(keys(many))) == 30
    assert not set(keys(many[1:])) & set(keys(reachable.views(30, 48, 32, seed=2)))


def test_views_go_on_beyond_a_round(reachable, monkeypatch):
    import pathtrace.region.view_selection as module

    monkeypatch.setattr(module, "_ROUND", 5)
    views = reachable.views(13, 32, 32, seed=1)
    assert keys(views)[:9] == keys(reachable.views(9, 32, 32, seed=1))
    assert len(set(keys(views))) == 13


def test_views_stand_in_the_region_and_look_at_something(reachable, joined):
    _, surfaces = joined
    views = reachable.views(30, 48, 32, seed=1) + reachable.unseen_views(30, 48, 32, seed=1)
    assert reachable.contains(np.array([view.position for view in views])).all()
    distance = looks_of(views).probe(surfaces, views[0], 12)
    assert (np.mean(distance < 2 * reachable.space.radius, axis=1) <= 0.1).all()
    for view in views:
        # A level horizon.
        assert abs(view.camera_to_world[1, 0]) < 1e-9


def test_views_to_judge_by_are_others_and_look_anywhere(reachable):
    unseen = reachable.unseen_views(200, 32, 32, seed=1)
    assert not set(keys(unseen)) & set(keys(reachable.views(30, 32, 32, seed=1)))
    forward = np.array([view.camera_to_world[:3, 2] for view in unseen])
    assert np.abs(forward[:, 1]).max() <= np.sin(np.radians(30)) + 1e-9
    np.testing.assert_allclose(forward[:, [0, 2]].mean(axis=0), 0, atol=0.2)
    assert unseen[0].fx == pytest.approx(unseen[0].fy)


def test_chosen_views_cover_more_than_views_at_random(reachable, joined):
    _, surfaces = joined
    judged = reachable.unseen_views(20, 32, 32, seed=0)

    def covered(views):
        coverage = ViewCoverage(surfaces, views)
        return np.mean([coverage.share(view) for view in judged])

    chosen = covered(reachable.views(12, 32, 32, seed=0))
    random = np.mean([covered(reachable.unseen_views(12, 32, 32, seed=s)) for s in (1, 2, 3)])
    assert chosen > random + 0.05
    assert covered(reachable.views(60, 32, 32, seed=0)) > chosen + 0.1


def test_near_views_are_the_ball_around_the_camera(joined):
    scene, surfaces = joined
    near = region_of(scene, surfaces, "near")
    views = near.views(24, 32, 32, seed=1)
    assert keys(near.views(5, 32, 32, seed=1)) == keys(views)[:5]
    assert keys(near.views(12, 32, 32, seed=1)) == keys(views)[:12]
    assert views[0].key == scene.camera.resized(32, 32).key
    assert len(set(keys(views))) == 24
    unseen = near.unseen_views(6, 32, 32, seed=0)
    assert not set(keys(unseen)) & set(keys(views))
    assert near.contains(np.array([view.position for view in views + unseen])).all()
    assert not near.contains(np.array([[-3.5, 0, 0], [-2, 1.5, 0]])).any()
    assert near.identity() == {"kind": "near"}


def test_up_is_an_axis_of_the_world_or_the_cameras_own(joined):
    scene, _ = joined
    np.testing.assert_allclose(upright(scene.camera), [0, 1, 0])
    rng = small.rng()
    rotations = turned_about(np.array([0, 0, 1.0]), 360 * rng.random(9), 40 * rng.random(9))
    np.testing.assert_allclose(
        rotations.transpose(0, 2, 1) @ rotations, np.tile(np.eye(3), (9, 1, 1)), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1)
    assert (rotations[:, 2, 2] >= 0).all()
    assert (rotations[:, 2, 1] < 0).all()


def test_narrow_views_are_widened_and_wide_ones_stay(joined):
    camera = joined[0].camera
    assert widened(camera, 40).key == camera.key
    assert widened(camera, 90).vertical_fov == pytest.approx(90)
