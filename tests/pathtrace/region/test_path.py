"""Regions of a camera's path: what the file may hold, and the space around it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.coordinate_systems import opengl_from_opencv
from pathtrace.region import region_of

pytestmark = pytest.mark.usefixtures("backend")
THROUGH_THE_DOOR = {
    "radius": 0.4,
    "frames": [
        {"position": [-3, 0, 0], "look_at": [4, 0, 0]},
        {"position": [0, 0, 0], "look_at": [4, 0, 0], "up": [0, 1, 0]},
        {"position": [3, 0, 0], "look_at": [3, 0, 2]},
    ],
}


@pytest.fixture(scope="module")
def path(joined, tmp_path_factory):
    file = tmp_path_factory.mktemp("path") / "path.json"
    file.write_text(json.dumps(THROUGH_THE_DOOR))
    return region_of(*joined, str(file))


def test_the_region_lies_around_the_path(path):
    assert path.name.endswith("path.json")
    points = np.array([[-3.0, 0, 0], [0, 0.3, 0], [1, 0, 0.35], [3, 0, 0.3], [3.3, 0.2, 0]])
    assert path.contains(points).all()
    # Too far, before the beginning, behind the wall beside the door, and not a number.
    points = np.array([[0, 0.5, 0], [-3.5, 0, 0], [1, 0, 0.65], [np.nan, 0, 0]])
    assert not path.contains(points).any()


def test_views_lie_along_the_path_and_look_about_where_it_does(path):
    views, unseen = path.views(20, 32, 32, seed=0), path.unseen_views(40, 32, 32, seed=0)
    assert [v.key for v in path.views(6, 32, 32, seed=0)] == [v.key for v in views[:6]]
    np.testing.assert_allclose(views[0].position, [-3, 0, 0])
    assert not {v.key for v in views} & {v.key for v in unseen}
    positions = np.array([view.position for view in views + unseen])
    assert path.contains(positions).all()
    assert np.ptp(positions[:, 0]) > 4
    for view in unseen:
        x, _, z = view.camera_to_world[:3, 2]
        expected = [0, 1] if view.position[0] > 1.5 else [1, 0]
        assert np.dot([x, z], expected) > np.cos(np.radians(23))


def test_a_matrix_is_a_pose_as_well_and_a_region_comes_back(path, joined, tmp_path):
    def region(document):
        (tmp_path / "path.json").write_text(json.dumps(document))
        return region_of(*joined, str(tmp_path / "path.json"))

    again = region(path.identity())
    for one, other in zip(path.views(4, 16, 16, 3), again.views(4, 16, 16, 3), strict=True):
        np.testing.assert_allclose(one.world_to_camera, other.world_to_camera, atol=1e-9)
    assert again.radius == path.radius
    matrix = opengl_from_opencv(joined[0].camera.camera_to_world).tolist()
    of_one = region({"kind": "path", "frames": [{"transform_matrix": matrix}]})
    np.testing.assert_allclose(of_one.views(1, 32, 32, 0)[0].position, joined[0].camera.position, atol=1e-6)


def frames(**changes):
    return {"frames": [{"position": [-3, 0, 0], "look_at": [4, 0, 0], **changes}]}


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ([], "is not a camera path; must be JSON with a list of poses under frames"),
        ({"frames": []}, "is not a camera path"),
        ({"frames": [3]}, r"frames\[0\] is not a pose \(not an object\)"),
        ({"frames": [{"position": [0, 0, 0]}]}, r"frames\[0\] is not a pose \(has no look_at\)"),
        (frames(position=[1, 2]), "position is not three numbers"),
        (frames(position="here"), r"frames\[0\] is not a pose"),
        (frames(look_at=[-3, 0, 0]), "no direction from"),
        (frames(up=[1, 0, 0]), "no direction from"),
        ({"frames": [{"transform_matrix": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]]}]}, "is not rigid"),
        ({**frames(), "radius": -1}, "radius is -1; must be a positive number"),
        ({**frames(), "radius": "wide"}, "radius is 'wide'"),
        ({"frames": frames()["frames"] * 1001}, "1,001 frames; must be at most 1,000"),
        (frames(position=[-3.999, 0, 0]), r"frames\[0\] lies on a surface"),
        (frames(position=[-90, 0, 0], look_at=[-99, 0, 0]), "no frame of the path sees a surface"),
    ],
)
def test_broken_files_are_refused_in_one_line(document, message, joined, tmp_path):
    file = tmp_path / "path.json"
    file.write_text(json.dumps(document))
    with pytest.raises(UserError, match=message) as caught:
        region_of(*joined, str(file))
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read_are_refused(joined, tmp_path):
    file = tmp_path / "path.json"
    with pytest.raises(UserError, match=r"path.json: cannot be read \(No such file"):
        region_of(*joined, str(file))
    file.write_text("{")
    with pytest.raises(UserError, match=r"path.json: cannot be read \("):
        region_of(*joined, str(file))
    with pytest.raises(UserError, match="region 'everywhere': must be near, reachable or the file"):
        region_of(*joined, "everywhere")
