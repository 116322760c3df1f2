"""Regions at the ends: without space, under the sky, through a wall, of one pose, tiny and huge."""

from __future__ import annotations

import json

import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.region import region_of
from pathtrace.scene.scene import load_scene
from tests import small
from tests.extremes import extreme
from tests.pathtrace.region import boxes
from tests.placed import placed

pytestmark = pytest.mark.usefixtures("backend")


@extreme(
    "reachable region without space",
    given="a camera in a pipe of 0.06 by 0.06 by 6 that ends in a hall",
    expected="refused in one line",
)
def test_a_pipe_without_space_is_refused(got):
    scene = load_scene(boxes.pipe())
    with pytest.raises(UserError, match="no free space around the scene's own camera for a viewer") as caught:
        region_of(scene, scene.surfaces(), "reachable")
    assert "\n" not in got(str(caught.value))


@extreme(
    "reachable region of nothing", given="a camera under the sky, no surface", expected="refused in one line"
)
def test_a_camera_that_sees_nothing_is_refused(got):
    scene = load_scene({"type": "scene", "sensor": small.sensor(), "sky": {"type": "constant"}})
    with pytest.raises(UserError, match="the scene's own camera sees no surface") as caught:
        region_of(scene, scene.surfaces(), "reachable")
    assert "\n" not in got(str(caught.value))


@extreme(
    "reachable region under the sky",
    given="a plane of 100 by 100, the camera 1.6 above it, 4 from what it looks at",
    expected="within 10 of the camera",
)
def test_a_region_in_the_open_ends(got):
    scene = load_scene(boxes.plain())
    region = region_of(scene, scene.surfaces(), "reachable")
    points = region.space.nodes - scene.camera.position
    assert got(float(np.linalg.norm(points, axis=1).max()), ".1f") < 10
    assert np.linalg.norm(points, axis=1).max() > 1
    assert region.space.nodes[:, 1].min() > 0
    assert len(region.views(4, 32, 32, 0)) == 4


@extreme("path through a wall", given="poses on either side of it", expected="refused, names the poses")
def test_a_path_through_a_wall_is_refused(joined, tmp_path, got):
    frames = [{"position": [x, 0, 1], "look_at": [4, 0, 0]} for x in (-3, -1, 2, 3)]
    (tmp_path / "p.json").write_text(json.dumps({"frames": frames}))
    with pytest.raises(UserError, match=r"a surface lies between frames\[1\] and frames\[2\]") as caught:
        region_of(*joined, str(tmp_path / "p.json"))
    assert "\n" not in got(str(caught.value).split("p.json: ")[1])


@extreme("path of one pose", given="one position", expected="a ball around it, views within")
def test_a_path_of_one_pose_is_a_ball(joined, tmp_path, got):
    frames = [{"position": [-2, 0, 0.5], "look_at": [4, 0, 0]}]
    (tmp_path / "p.json").write_text(json.dumps({"frames": frames}))
    region = region_of(*joined, str(tmp_path / "p.json"))
    offsets = np.array([view.position for view in region.views(12, 32, 32, 0)]) - [-2, 0, 0.5]
    assert 0.2 < got(float(np.linalg.norm(offsets, axis=1).max()), ".2f") <= region.radius


@pytest.mark.parametrize(
    "scale",
    [
        pytest.param(
            s,
            marks=extreme(
                f"reachable region at a scale of {s:g}",
                given="two rooms",
                expected="as many nodes to 3 %",
            ),
        )
        for s in (1e-4, 1e5)
    ],
)
def test_regions_of_any_size_are_the_same(scale, reachable, got):
    scene = load_scene(placed(boxes.rooms(1.2), scale, 0.0))
    region = region_of(scene, scene.surfaces(), "reachable")
    assert got(len(region.space.nodes) / len(reachable.space.nodes), ".3f") == pytest.approx(1, abs=0.03)
    low, high = (scene.place.in_world(end[None])[0] / scale for end in _ends(region.space.nodes))
    expected = _ends(reachable.space.nodes)
    np.testing.assert_allclose([low, high], expected, atol=0.01)
    assert len(region.views(2, 32, 32, 0)) == 2


def _ends(points):
    return points.min(axis=0), points.max(axis=0)
