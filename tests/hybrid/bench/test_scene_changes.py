"""What changes in a scene after the splats were trained."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.bench.scene_changes import CHANGES, dim_lamps, move_object, swap_colours
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


def parameters(scene, part: str) -> dict[str, np.ndarray]:
    """Values of the parameters whose name has a part."""
    return {name: np.ravel(value) for name, value in mi.traverse(scene.mitsuba) if part in name}


def test_lamps_are_dimmed_to_two_fifths():
    scene = load_scene(small.corner())
    (before,) = parameters(scene, "radiance.value").values()
    dim_lamps(scene, scene.camera)
    (after,) = parameters(scene, "radiance.value").values()
    np.testing.assert_allclose(after, 0.4 * before, rtol=1e-6)


def test_colours_of_visible_shapes_change_places():
    """The board's 0.2, 0.3, 0.8 become 0.3, 0.8, 0.2."""
    scene = load_scene(small.corner())
    swap_colours(scene, scene.camera)
    values = [value.tolist() for value in parameters(scene, "reflectance.value").values()]
    assert pytest.approx([0.3, 0.8, 0.2]) in values
    assert pytest.approx([0.2, 0.3, 0.8]) not in values


def test_all_changes_have_a_name():
    assert set(CHANGES.values()) == {move_object, swap_colours, dim_lamps}
