"""What a viewer can reach: every corner of a room, the next one through a door, nothing through a slit."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.region.reachable import FreeSpace, ReachableRegion
from pathtrace.scene.scene import load_scene
from tests.pathtrace.region import boxes

pytestmark = pytest.mark.usefixtures("backend")


def space_of(description: dict) -> FreeSpace:
    scene = load_scene(description)
    return FreeSpace(scene, scene.surfaces())


def test_a_room_is_filled_to_its_corners(reachable):
    space = reachable.space
    # The radius and a cell of the lattice may lie between a node and a wall.
    reach = space.radius + space.spacing
    assert (space.nodes.min(axis=0) <= np.array([-4, -1.5, -2]) + reach).all()
    assert (space.nodes.max(axis=0) >= np.array([4, 1.5, 2]) - reach).all()
    assert (np.abs(space.nodes) <= np.array([4, 1.5, 2]) - space.radius * 0.9).all()


@pytest.mark.parametrize("gap", [0.0, 0.02, 0.1])
def test_a_slit_narrower_than_a_viewer_is_no_door(gap):
    space = space_of(boxes.rooms(gap))
    assert gap < 2 * space.radius
    assert space.nodes[:, 0].max() < 1
    assert not space.contains(np.array([[2.0, 0, 0], [3, 1, 1]])).any()


def test_no_step_leads_through_a_slit():
    """Wherever the wall lies between the nodes of the lattice: also half-way, clear of both."""
    for x in np.linspace(-2.3, -2.0, 6):
        assert space_of(boxes.rooms(0.12, x)).nodes[:, 0].max() < 1


def test_points_are_free_or_not(reachable, joined):
    scene, _ = joined
    inside = [[-3.0, 0, 0], [3, 1, -1], [1, 0, 0], [-0.5, -1, 1.5]]
    outside = [[-3.0, 1.499, 0], [5, 0, 0], [1, 0, 1.5], [np.nan, 0, 0], [1e30, 0, 0], [0, 2, 0]]
    found = reachable.contains(np.array(inside + outside + [scene.camera.position.tolist()]))
    assert found.tolist() == [True] * 4 + [False] * 6 + [True]


def test_samples_fill_the_space_evenly(reachable):
    points = reachable.space.sample(4000, np.random.default_rng(0))
    assert points.shape == (4000, 3)
    assert reachable.contains(points).all()
    # Five of eight metres lie in the larger room.
    assert np.mean(points[:, 0] < 1) == pytest.approx(5 / 8, abs=0.04)
    np.testing.assert_allclose(points[:, 1:].mean(axis=0), 0, atol=0.08)


def test_a_viewer_does_not_climb_out_of_a_window():
    """The end of the larger room has a hole of 1 by 1, and there is ground outside."""
    wide = boxes.rooms(0.0)
    del wide["shell"]
    sides = {
        "low": boxes.shell(30, 0.01, 30) | {"to_world": _moved([0, -1.5, 0], [30, 0.01, 30])},
        "high": boxes.shell(4, 0.01, 2) | {"to_world": _moved([0, 1.5, 0], [4, 0.01, 2])},
        "back": boxes.shell(4, 1.5, 0.01) | {"to_world": _moved([0, 0, -2], [4, 1.5, 0.01])},
        "front": boxes.shell(4, 1.5, 0.01) | {"to_world": _moved([0, 0, 2], [4, 1.5, 0.01])},
    }
    for number, (y, z, height, depth) in enumerate(
        [(-1, 0, 0.5, 2), (1, 0, 0.5, 2), (0, -1.25, 0.5, 0.75), (0, 1.25, 0.5, 0.75)]
    ):
        sides[f"frame{number}"] = boxes.shell(1, 1, 1) | {
            "to_world": _moved([-4, y, z], [0.01, height, depth])
        }
    space = space_of({**wide, **sides})
    assert len(space.nodes) > 500
    # The window itself may be stood in.
    assert space.nodes[:, 0].min() > -4.5


def test_the_lattice_ends_in_a_larger_scene(joined, monkeypatch):
    import pathtrace.region.reachable as module

    monkeypatch.setattr(module, "_MOST_NODES", 300)
    region = ReachableRegion(*joined)
    assert 100 < len(region.space.nodes) <= 300

    # The nearest ones.
    assert np.abs(region.space.nodes - joined[0].camera.position).max() < 2.5


def _moved(offset: list[float], scale: list[float]):
    import mitsuba as mi

    return mi.ScalarTransform4f().translate(offset).scale(scale)
