"""What changes in a scene after the splats were trained."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.bench.scene_changes import move_object
from pathtrace.scene.scene import load_scene
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def cube(x: float) -> dict[str, object]:
    return {"type": "cube", "to_world": mi.ScalarTransform4f().translate([x, 0, 1.2]).scale(0.2)}


def meshes(scene) -> list[np.ndarray]:
    """(N, 3) vertices of each mesh."""
    found = [mi.traverse(shape) for shape in scene.mitsuba.shapes()]
    return [each["vertex_positions"].numpy().reshape(-1, 3) for each in found if "vertex_positions" in each]


def test_a_mesh_is_moved_where_another_shape_fills_a_tenth():
    scene = load_scene({**small.corner(), "cube": cube(0.1)})
    (before,) = meshes(scene)
    move_object(scene, scene.camera)
    (after,) = meshes(scene)
    aside = scene.camera.camera_to_world[:3, 0] * 0.2
    np.testing.assert_allclose(after, before + aside, atol=1e-5)


def test_a_mesh_that_lies_there_twice_is_moved():
    scene = load_scene({**small.corner(), "cube": cube(0.1), "copy": cube(0.1)})
    before = meshes(scene)
    move_object(scene, scene.camera)
    assert not np.allclose(meshes(scene)[0], before[0])


def test_a_view_without_a_mesh_is_refused():
    scene = load_scene(small.corner())
    with pytest.raises(UserError, match="a view sees no mesh that could be moved"):
        move_object(scene, scene.camera)
