"""Scenes of instances: what rays hit is what Mitsuba says, and kernels do not grow with their number."""

from __future__ import annotations

import json
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pathtrace.scene.instances import InstancedScene, seen_shapes
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.first_hit import has_clear_surfaces
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")

GREY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.3, 0.6, 0.2]}}


def placed(*steps: tuple[str, Any]) -> Any:
    transform = mi.ScalarTransform4f()
    for name, value in steps:
        arguments = value if name == "rotate" else [value]
        transform = getattr(transform, name)(*arguments)
    return transform


def group(number: int, shapes: dict[str, Any]) -> dict[str, Any]:
    return {f"group-{number}": {"type": "shapegroup", **shapes}}


def instance(number: int, to_world: Any) -> dict[str, Any]:
    return {"type": "instance", "to_world": to_world, "of": {"type": "ref", "id": f"group-{number}"}}


def around() -> dict[str, Any]:
    """A camera that looks at a wall under the sky."""
    facing = placed(("translate", [0, 0, 2]), ("rotate", ([0, 1, 0], 180)), ("scale", 4))
    wall = {"type": "rectangle", "to_world": facing, "bsdf": GREY}
    light = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    return {"type": "scene", "sensor": small.sensor(), "wall": wall, "light": light}


def repeated(count: int = 3) -> dict[str, Any]:
    """Boxes, balls and a mirror disk of two groups, turned, stretched and mirrored, before a wall."""
    shapes = {
        **group(0, {"box": {"type": "cube", "bsdf": GREY}, "ball": {"type": "sphere", "center": [2, 0, 0]}}),
        **group(1, {"disk": {"type": "disk", "bsdf": {"type": "conductor"}}}),
    }
    for number in range(count):
        to_world = placed(
            ("translate", [0.4 * number - 0.4, 0.1 * number - 0.1, 1.0]),
            ("rotate", ([2 / 3, 1 / 3, 2 / 3], 40.0 * number)),
            ("scale", [0.12, 0.2 if number % 2 else -0.2, 0.15]),
        )
        shapes[f"copy-{number}"] = instance(number % 2, to_world)
    return {**around(), **shapes}


def rays(count: int = 4000) -> Any:
    """Rays from where the camera is, over what it sees."""
    rng = np.random.default_rng(3)
    way = np.stack([rng.uniform(-0.7, 0.5, count), rng.uniform(-0.6, 0.4, count), np.ones(count)])
    way /= np.linalg.norm(way, axis=0)
    return mi.Ray3f(mi.Point3f(0.3, 0.2, -1.0), mi.Vector3f(way.astype(np.float32)))


def registered(pointers: Any) -> np.ndarray:
    return np.array(dr.reinterpret_array(mi.UInt32, pointers))


FLAGS = mi.RayFlags.All | mi.RayFlags.dNSdUV
FIELDS = ("t", "p", "n", "uv", "dp_du", "dp_dv", "dn_du", "dn_dv", "wi")


def test_rays_hit_what_mitsuba_says():
    whole = mi.load_dict(repeated())
    expected = whole.ray_intersect(rays(), FLAGS, False, True)
    found = InstancedScene(whole).ray_intersect(rays(), FLAGS)
    of_group = registered(expected.instance)
    assert set(np.bincount(of_group)[np.unique(of_group)] > 20) == {True}
    assert len(np.unique(of_group)) == 4
    np.testing.assert_array_equal(registered(found.instance), of_group)
    np.testing.assert_array_equal(registered(found.shape), registered(expected.shape))
    for name in FIELDS:
        np.testing.assert_allclose(
            np.array(getattr(found, name)), np.array(getattr(expected, name)), atol=1e-5, err_msg=name
        )
    for axis in "snt":
        np.testing.assert_allclose(
            np.array(getattr(found.sh_frame, axis)), np.array(getattr(expected.sh_frame, axis)), atol=1e-5
        )


def test_what_misses_is_as_mitsuba_says():
    whole = mi.load_dict(repeated())
    away = mi.Ray3f(mi.Point3f(0, 0, 0), mi.Vector3f([0.0, 1.0], [0.0, 0.0], [-1.0, 0.0]))
    found, expected = (
        each.ray_intersect(away, FLAGS, False, True) for each in (InstancedScene(whole), whole)
    )
    assert not np.array(found.is_valid()).any()
    assert not registered(found.shape).any()
    np.testing.assert_array_equal(np.array(found.n), np.array(expected.n))
    np.testing.assert_array_equal(np.array(found.wi), np.array(expected.wi))


def operations(count: int) -> int:
    """Of the kernel that finds what rays hit among so many instances."""
    scene = InstancedScene(mi.load_dict(repeated(count)))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(scene.ray_intersect(rays()))
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    return max(kernel["operation_count"] for kernel in kernels)


def test_kernels_do_not_grow_with_the_number_of_instances():
    assert operations(2) == operations(12)


def without_instances() -> dict[str, Any]:
    """The same as `twice`, of balls alone."""
    ball = {"type": "sphere", "radius": 0.25, "bsdf": GREY}
    places = ([-0.3, 0, 1], [0.4, 0.1, 1.2])
    balls = {f"ball-{n}": {**ball, "to_world": placed(("translate", at))} for n, at in enumerate(places)}
    return {**around(), **balls}


def twice() -> dict[str, Any]:
    ball = {"type": "sphere", "radius": 0.25, "bsdf": GREY}
    places = ([-0.3, 0, 1], [0.4, 0.1, 1.2])
    copies = {f"copy-{n}": instance(0, placed(("translate", at))) for n, at in enumerate(places)}
    return {**around(), **group(0, {"ball": ball}), **copies}


def frame(scene: Scene) -> np.ndarray:
    """(3, N) radiance, by paths of the same kind whether there are instances or not."""
    camera = scene.camera
    tracer = Tracer(scene, most_indirect=1e9)
    traced = tracer.trace(camera, frame_positions(camera), 16, 1, features=True)
    return np.stack([np.array(channel) for channel in traced.radiance])


def test_instances_look_like_the_shapes_themselves():
    copies, shapes = (frame(load_scene(scene())) for scene in (twice, without_instances))
    assert copies.std() > 0.05
    # Rounding sends a path elsewhere now and then.
    assert np.mean(np.abs(copies - shapes) > 1e-3) < 0.02
    assert copies.mean() == pytest.approx(shapes.mean(), rel=1e-3)


def test_triangles_are_counted_as_they_are_seen():
    # Two of three copies are of the group with a box; a rectangle is two triangles, a ball and a disk none.
    assert load_scene(repeated()).triangles == 2 + 2 * 12
    assert load_scene({**repeated(), "own": {"type": "cube"}}).triangles == 2 + 3 * 12


def test_surfaces_of_groups_are_known():
    scene = load_scene(repeated())
    assert {shape.class_name() for shape in seen_shapes(scene.mitsuba)} == {
        "Cube",
        "Sphere",
        "Disk",
        "Rectangle",
    }
    assert has_clear_surfaces(scene.mitsuba)
    assert not has_clear_surfaces(load_scene(twice()).mitsuba)


def test_a_scene_may_consist_of_an_instance_of_nothing():
    empty = {key: part for key, part in around().items() if key != "wall"}
    empty |= {**group(0, {}), "copy": instance(0, placed())}
    assert load_scene(empty).instanced is None
    assert load_scene({**around(), **empty}).triangles == 2


def test_an_instance_moves(tmp_path):
    motion = {"shapes": {"copy-0": {"keyframes": [{"t": 0}, {"t": 1, "translate": [0, 0, 0.5]}]}}}
    (tmp_path / "motion.json").write_text(json.dumps(motion))
    scene = load_scene(twice(), motion=tmp_path / "motion.json")
    tracer, camera = Tracer(scene), scene.camera
    seen = []
    for time in (0.0, 1.0, 0.0):
        scene.set_time(time)
        seen.append(tracer.trace(camera, frame_positions(camera), 4, 1, features=True))
    depth = [np.array(each.features.position[2]).reshape(32, 32) for each in seen]
    # Where the ball is seen before and after.
    ball = (depth[0] < 0.99) & (depth[1] > depth[0]) & (depth[1] < 1.5)
    assert ball.sum() > 5
    np.testing.assert_array_equal(depth[2], depth[0])
    assert np.median((depth[1] - depth[0])[ball]) == pytest.approx(0.5, abs=0.1)
