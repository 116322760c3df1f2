"""Scenes at a time: what has a track moves, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compose.base.errors import UserError
from compose.base.traced_samples import UNSTEADY
from pathtrace.gltf.meshes import write_mesh
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.compose.arrays_of import channels, floats, host
from tests.extremes import extreme

pytestmark = pytest.mark.usefixtures("backend")

XML = """<scene version="3.0.0">
<sensor type="perspective"><transform name="to_world">
  <lookat origin="0, 0, -4" target="0, 0, 0" up="0, 1, 0"/></transform>
  <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="48"/></film></sensor>
<bsdf type="diffuse" id="white"/>
<shape type="cube" id="left"><transform name="to_world"><scale value="0.3"/><translate x="-1"/></transform>
  <ref id="white"/></shape>
<shape type="cube" id="right"><transform name="to_world"><scale value="0.3"/><translate x="1"/></transform>
  <ref id="white"/></shape>
<shape type="cube" id="wall"><transform name="to_world"><scale x="3" y="3" z="0.1"/>
  <translate z="2"/></transform><ref id="white"/></shape>
<shape type="sphere" id="ball"><float name="radius" value="0.2"/><ref id="white"/></shape>
<emitter type="point" id="lamp"><point name="position" x="0" y="0" z="-3"/>
  <rgb name="intensity" value="9, 9, 9"/></emitter>
</scene>"""


def keys(*rows: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"keyframes": list(rows), **more}


def loaded(folder: Path, motion: dict[str, Any], xml: str = XML) -> Scene:
    (folder / "box.xml").write_text(xml)
    (folder / "box.motion.json").write_text(json.dumps(motion))
    return load_scene(folder / "box.xml")


def hits(scene: Scene) -> np.ndarray:
    """(H W, 3) first points that the scene's camera sees."""
    camera = scene.camera
    found = Tracer(scene).hits(camera, frame_positions(camera))
    return camera.position + camera.rays(camera.pixel_centres()) * found.distance[:, None]


def centre_of(scene: Scene, low: list[float], high: list[float]) -> np.ndarray:
    """Centre of the box around what is seen within a box."""
    points = hits(scene)
    inside = points[((points > low) & (points < high)).all(axis=1)]
    return (inside.min(axis=0) + inside.max(axis=0)) / 2


RIGHT = keys({"t": 0}, {"t": 1, "translate": [0, 0.8, 0]})


def test_a_shape_follows_its_track_and_all_else_stays(tmp_path):
    scene = loaded(tmp_path, {"shapes": {"right": RIGHT}})
    before = hits(scene)
    for time, y in ((0.0, 0.0), (1.0, 0.8), (0.5, 0.4), (0.0, 0.0)):
        scene.set_time(time)
        assert centre_of(scene, [0.5, -2, -0.5], [1.5, 2, 0.5])[1] == pytest.approx(y, abs=0.06)
        assert centre_of(scene, [-1.5, -2, -0.5], [-0.5, 2, 0.5])[1] == pytest.approx(0, abs=0.06)
    np.testing.assert_array_equal(hits(scene), before)


def test_meshes_without_a_track_are_merged_and_those_with_one_are_not(tmp_path):
    assert len(loaded(tmp_path, {"shapes": {"right": RIGHT}}).mitsuba.shapes()) == 3
    (tmp_path / "box.motion.json").unlink()
    still = load_scene(tmp_path / "box.xml")
    assert len(still.mitsuba.shapes()) == 2
    assert still.moving is None
    with pytest.raises(UserError, match="box: nothing moves in this scene"):
        still.set_time(0.0)


def test_a_scene_is_at_the_beginning_when_it_is_loaded(tmp_path):
    scene = loaded(tmp_path, {"shapes": {"right": keys({"t": 0, "translate": [0, -0.5, 0]})}})
    assert centre_of(scene, [0.5, -2, -0.5], [1.5, 2, 0.5])[1] == pytest.approx(-0.5, abs=0.06)


def test_shapes_without_vertices_move_as_well(tmp_path):
    scene = loaded(tmp_path, {"shapes": {"ball": keys({"t": 0}, {"t": 1, "translate": [0, -0.5, 0]})}})
    scene.set_time(1.0)
    assert centre_of(scene, [-0.3, -2, -0.5], [0.3, 2, 0.5])[1] == pytest.approx(-0.5, abs=0.06)


def test_normals_turn_with_the_shape(tmp_path):
    xml = XML.replace('<cube id="right">', '<cube id="right"><boolean name="face_normals" value="false"/>')
    track = keys({"t": 0}, {"t": 1, "degrees": 30}, axis=[0, 1, 0], about=[1, 0, 0])
    scene = loaded(tmp_path, {"shapes": {"right": track}}, xml)
    # On ways there and back: what is written to the memory of normals must not become what they are at rest.
    for time in (1.0, 0.5, 0.0, 1.0):
        scene.set_time(time)
    camera = scene.camera
    features = Tracer(scene).auxiliary(camera, frame_positions(camera), 1, 0)
    normals = np.stack([part.numpy() for part in features.normal], axis=1)
    points = hits(scene)
    front = (np.abs(points[:, 0] - 1) < 0.15) & (np.abs(points[:, 1]) < 0.2)
    expected = [-np.sin(np.radians(30)), 0, -np.cos(np.radians(30))]
    np.testing.assert_allclose(np.median(normals[front], axis=0), expected, atol=1e-3)


def test_normals_follow_a_formula(tmp_path):
    """They are those of the faces where these meet in no edge: on the front, which is sheared."""
    scene = loaded(tmp_path, {"shapes": {"right": {"formula": ["x", "y", "z + 0.5 * t * x"]}}})
    scene.set_time(1.0)
    parameters = mi.traverse(scene.mitsuba)
    (key,) = [k for k in parameters.keys() if k.endswith("vertex_normals") and len(parameters[k]) == 72]  # noqa: SIM118
    normals = np.reshape(parameters[key].numpy(), (-1, 3))
    vertices = np.reshape(parameters[key.replace("normals", "positions")].numpy(), (-1, 3))
    front = normals @ [0, 0, -1] > 0.5
    assert front.sum() == 4
    np.testing.assert_allclose(normals[front], [np.array([0.5, 0, -1]) / np.sqrt(1.25)] * 4, atol=1e-6)
    np.testing.assert_allclose(np.ptp(vertices[front] @ [0.5, 0, -1]), 0, atol=1e-6)


def test_vertices_follow_a_formula(tmp_path):
    scene = loaded(tmp_path, {"shapes": {"right": {"formula": ["x", "y + t * z", "z"]}}})
    scene.set_time(1.0)
    # The front, at z = -0.3, is lower by that.
    front = hits(scene)
    front = front[np.abs(front[:, 2] + 0.3) < 1e-3]
    right = front[front[:, 0] > 0.5]
    assert (right[:, 1].min() + right[:, 1].max()) / 2 == pytest.approx(-0.3, abs=0.06)


def test_vertices_go_from_mesh_to_mesh(tmp_path):
    cube = mi.load_dict({"type": "cube", "to_world": mi.ScalarTransform4f().translate([1, 0, 0]).scale(0.3)})
    for number, shift in enumerate((0.0, 0.6, 0.0)):
        moved = mi.traverse(cube)
        moved["vertex_positions"] = moved["vertex_positions"] + mi.Float([0, shift, 0] * 24)
        moved.update()
        cube.write_ply(str(tmp_path / f"{number}.ply"))
        moved["vertex_positions"] = moved["vertex_positions"] - mi.Float([0, shift, 0] * 24)
        moved.update()
    scene = loaded(tmp_path, {"shapes": {"right": {"meshes": [f"{number}.ply" for number in range(3)]}}})
    for time, y in ((0.25, 0.3), (0.5, 0.6), (1.0, 0.0)):
        scene.set_time(time)
        assert centre_of(scene, [0.5, -2, -0.5], [1.5, 2, 0.5])[1] == pytest.approx(y, abs=0.06)


def test_lights_move_and_change(tmp_path):
    def brightness(scene: Scene) -> np.ndarray:
        traced = Tracer(scene).trace(scene.camera, frame_positions(scene.camera), 16)
        return np.stack([channel.numpy() for channel in traced.radiance], axis=1).reshape(48, 48, 3)

    factor = keys({"t": 0}, {"t": 1, "factor": [1, 0.5, 0]})
    moved = keys({"t": 0}, {"t": 1, "translate": [2.5, 0, 0]})
    scene = loaded(tmp_path, {"shapes": {"lamp": moved}, "lights": {"lamp": factor}})
    before = brightness(scene)
    scene.set_time(1.0)
    after = brightness(scene)
    assert after[..., 2].max() == 0
    np.testing.assert_allclose(after[..., 1], after[..., 0] / 2, rtol=1e-4)
    sides = [np.sort([image[:, :8, 0].mean(), image[:, -8:, 0].mean()]) for image in (before, after)]
    assert sides[0][0] == pytest.approx(sides[0][1], rel=0.05)
    assert sides[1][0] < 0.7 * sides[1][1]


def test_area_lights_change_by_the_shape_that_shines(tmp_path):
    emitter = '<emitter type="area"><rgb name="radiance" value="2, 2, 2"/></emitter>'
    xml = XML.replace('<float name="radius" value="0.2"/>', f'<float name="radius" value="0.2"/>{emitter}')
    scene = loaded(tmp_path, {"lights": {"ball": keys({"t": 0, "factor": 1}, {"t": 1, "factor": 3})}}, xml)
    scene.set_time(1.0)
    traced = Tracer(scene).trace(scene.camera, frame_positions(scene.camera), 4)
    assert np.reshape(traced.radiance[0].numpy(), (48, 48))[24, 24] == pytest.approx(6, rel=0.1)


FACTOR = keys({"t": 0}, {"t": 1, "factor": 0.2})


@pytest.mark.parametrize(
    "motion",
    [
        {"shapes": {"right": RIGHT}},
        {"shapes": {"right": {"formula": ["x", "y + 0.5 * t", "z - 0.2 * t * x"]}}},
        {"shapes": {"ball": RIGHT}},
        {"shapes": {"lamp": RIGHT}},
        {"lights": {"lamp": FACTOR}},
        {"shapes": {"right": RIGHT, "left": RIGHT, "ball": RIGHT, "lamp": RIGHT}, "lights": {"lamp": FACTOR}},
    ],
    ids=["mesh", "formula", "sphere", "light", "brightness", "all"],
)
@pytest.mark.usefixtures("no_garbage")
def test_nothing_is_recorded_again_when_time_passes(tmp_path, motion):
    scene = loaded(tmp_path, motion)
    tracer, seen = Tracer(scene), []
    for time in (0.0, 0.3, 0.6, 1.0):
        scene.set_time(time)
        traced = tracer.trace(scene.camera, frame_positions(scene.camera), 4)
        seen.append(np.stack([channel.numpy() for channel in traced.radiance]))
        fresh = Tracer(scene).trace(scene.camera, frame_positions(scene.camera), 4)
        np.testing.assert_array_equal(seen[-1], np.stack([channel.numpy() for channel in fresh.radiance]))
    assert tracer._trace_radiance._recorded.n_recordings <= 2
    assert all(np.abs(seen[0] - later).max() > 0.02 for later in seen[1:])


def test_the_motion_is_part_of_the_scenes_hash(tmp_path):
    scene = loaded(tmp_path, {"shapes": {"right": RIGHT}})
    other = loaded(tmp_path, {"shapes": {"right": RIGHT}, "seconds": 2})
    (tmp_path / "box.motion.json").unlink()
    assert len({scene.hash, other.hash, load_scene(tmp_path / "box.xml").hash}) == 3


def test_a_far_away_scene_moves_by_the_numbers_of_its_file(tmp_path):
    """It is held in coordinates of its own."""
    near = loaded(tmp_path, {"shapes": {"right": keys({"t": 0}, {"t": 1, "degrees": 90}, about=[1, 0.5, 0])}})
    near.set_time(1.0)
    shift = 3000.0
    to_world = '<translate x="{}"/></transform>'
    xml = XML
    for x in ("-1", "1"):
        xml = xml.replace(to_world.format(x), to_world.format(float(x) + shift))
    xml = xml.replace('<translate z="2"/>', f'<translate x="{shift}" z="2"/>')
    xml = xml.replace('origin="0,', f'origin="{shift},').replace('target="0,', f'target="{shift},')
    xml = xml.replace(
        '<float name="radius" value="0.2"/>',
        f'<float name="radius" value="0.2"/><point name="center" x="{shift}" y="0" z="0"/>',
    )
    xml = xml.replace('name="position" x="0"', f'name="position" x="{shift}"')
    track = keys({"t": 0}, {"t": 1, "degrees": 90}, about=[1 + shift, 0.5, 0])
    far = loaded(tmp_path, {"shapes": {"right": track}}, xml)
    far.set_time(1.0)
    assert far.place.origin[0] == shift
    distances = [np.linalg.norm(hits(scene) - scene.camera.position, axis=1) for scene in (near, far)]
    assert np.median(np.abs(distances[1] * far.place.unit - distances[0])) < 1e-4
    assert np.mean(np.abs(distances[1] * far.place.unit - distances[0]) < 1e-3) > 0.99


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        ({"shapes": {"door": RIGHT}}, "motion of door: there is no such shape or light in the scene"),
        ({"lights": {"door": keys({"t": 0})}}, "motion of door: there is no such light in the scene"),
        ({"lights": {"left": keys({"t": 0})}}, "motion of left: it has no radiance that could change"),
        ({"shapes": {"ball": {"formula": ["x", "y", "z"]}}}, "motion of ball: it has no vertices"),
        ({"shapes": {"white": RIGHT}}, "motion of white: there is no such shape or light in the scene"),
        ({"shapes": {"right": {"formula": ["x", "y", "z / t"]}}}, "right: formula has no finite value"),
    ],
)
def test_tracks_of_what_cannot_move_are_refused(tmp_path, motion, said):
    with pytest.raises(UserError, match=said):
        loaded(tmp_path, motion)


def test_a_mesh_of_another_size_is_refused(tmp_path):
    ball = mi.load_dict({"type": "cube"})
    ball.write_ply(str(tmp_path / "a.ply"))
    (tmp_path / "b.ply").write_text("no mesh")
    with pytest.raises(UserError, match=r"motion of left: .*b\.ply: cannot be read"):
        loaded(tmp_path, {"shapes": {"left": {"meshes": ["a.ply", "b.ply"]}}})


@pytest.mark.parametrize("time", [-0.1, 1.1, float("nan")])
def test_times_are_from_0_to_1(tmp_path, time):
    scene = loaded(tmp_path, {"shapes": {"right": RIGHT}})
    with pytest.raises(UserError, match=rf"^time {time:g}: must be from 0 to 1$"):
        scene.set_time(time)


def test_dictionaries_can_be_given_a_motion(tmp_path):
    file = tmp_path / "any.json"
    file.write_text(json.dumps({"shapes": {"board": keys({"t": 0}, {"t": 1, "translate": [0, 0.5, 0]})}}))
    scene = load_scene(small.corner(), motion=file)
    before = hits(scene)
    scene.set_time(1.0)
    assert 0.02 < (np.abs(hits(scene) - before).max(axis=1) > 1e-3).mean() < 0.3


def test_samples_tell_which_mover_they_show(tmp_path, arrays):
    """Two that move rigidly, one that deforms, and a wall that stands still; at rest, all are in place."""
    formula = {"formula": ["x", "y + 0.1 * t", "z"]}
    turning = keys({"t": 0}, {"t": 1, "translate": [0, 0.5, 0], "degrees": 40}, about=[1, 0, 0])
    motion = {"shapes": {"right": turning, "ball": RIGHT, "left": formula}}
    scene = loaded(tmp_path, motion)
    camera, at_start = scene.camera, hits(scene)
    tracer, positions = Tracer(scene), frame_positions(camera)
    scene.set_time(0.7)
    points = hits(scene)
    x, before_wall = points[:, 0], points[:, 2] < 1
    expected = np.select(
        [before_wall & (x > 0.5), before_wall & (x > -0.5), before_wall], [1, 2, UNSTEADY], 0
    )
    for features in (
        tracer.auxiliary(camera, positions, 1, 0),
        tracer.trace(camera, positions, 1, features=True).features,
    ):
        mover = features.mover.numpy()
        # At silhouettes, samples beside the centre of a pixel may show something else.
        assert (mover != expected).mean() < 0.06
        assert set(np.unique(mover)) == {0, 1, 2, UNSTEADY}
    given = channels(arrays, points), floats(arrays, expected)
    rest = host(scene.moving.moment().at_rest(arrays, *given))
    np.testing.assert_allclose(np.linalg.norm(rest[expected == 2], axis=1), 0.2, atol=1e-4)
    assert np.abs(rest[expected == 1] - [1, 0, 0]).max() < 0.3 + 1e-4
    still = (expected == 0) & (at_start[:, 2] > 1)
    np.testing.assert_allclose(rest[still], at_start[still], atol=1e-5)


def test_what_a_mirror_shows_is_unsteady(tmp_path):
    xml = XML.replace(
        '<translate z="2"/></transform><ref id="white"/>',
        '<translate z="2"/></transform><bsdf type="conductor"/>',
    )
    scene = loaded(tmp_path, {"shapes": {"right": RIGHT}}, xml)
    features = Tracer(scene).auxiliary(scene.camera, frame_positions(scene.camera), 1, 0)
    mover = features.mover.numpy().reshape(48, 48)
    assert mover[2, 24] == UNSTEADY
    assert mover[24, 24] == 0


def test_where_nothing_moves_samples_know_of_no_movers(tmp_path):
    (tmp_path / "box.xml").write_text(XML)
    scene = load_scene(tmp_path / "box.xml")
    assert Tracer(scene).auxiliary(scene.camera, frame_positions(scene.camera), 1, 0).mover is None


def test_courses_say_where_shapes_are(tmp_path):
    """Those that move rigidly: what is seen on one, taken back to rest by its course, is on it at rest."""
    turning = keys(
        {"t": 0}, {"t": 1, "translate": [0, 0.3, 0], "degrees": 40}, axis=[1, 2, 0], about=[1, 0, 0]
    )
    motion = {"shapes": {"right": turning, "lamp": RIGHT}}
    scene = loaded(tmp_path, motion)
    assert scene.moving is not None
    (course,) = scene.moving.courses(5)
    assert course.name == "right"
    scene.set_time(0.75)
    found = Tracer(scene).hits(scene.camera, frame_positions(scene.camera))
    points = hits(scene)[found.shape == course.shape]
    assert len(points) > 50
    turn = Rotation.from_quat(course.rotations[3][[1, 2, 3, 0]])
    at_rest = turn.inv().apply(points - course.centre - course.shifts[3]) + course.centre
    np.testing.assert_allclose(np.abs(at_rest - [1, 0, 0]).max(axis=1), 0.3, atol=1e-4)


BALL = """<shape type="ply" id="round"><string name="filename" value="ball.ply"/>{bsdf}</shape>"""
IMAGE = """<bsdf type="diffuse"><texture type="bitmap" name="reflectance">
  <string name="filename" value="image.png"/></texture></bsdf>"""


@pytest.mark.parametrize(("bsdf", "turns"), [("<ref id='white'/>", False), (IMAGE, True)])
def test_turns_that_nobody_sees_are_no_part_of_a_course(tmp_path, bsdf, turns):
    """Those of a ball, unless an image is painted on it; it goes where it goes in either case."""
    mi.util.write_bitmap(str(tmp_path / "image.png"), np.random.default_rng(0).random((4, 4, 3)))
    write_ball(tmp_path / "ball.ply")
    xml = XML.replace("</scene>", BALL.format(bsdf=bsdf) + "</scene>")
    track = keys({"t": 0}, {"t": 1, "degrees": 90, "translate": [0.5, 0, 0]}, axis=[1, 0, 0])
    scene = loaded(tmp_path, {"shapes": {"round": track}}, xml)
    assert scene.moving is not None
    (course,) = scene.moving.courses(3)
    turned = Rotation.from_quat(course.rotations[:, [1, 2, 3, 0]]).magnitude()
    np.testing.assert_allclose(turned, np.radians([0, 45, 90]) if turns else 0, atol=1e-6)
    np.testing.assert_allclose(course.shifts[2], [0.5, 0, 0], atol=1e-6)


def write_ball(file: Path) -> None:
    """A ball of radius 0.3 around the origin, as triangles."""
    u, v = np.meshgrid(np.linspace(0, np.pi, 33), np.linspace(0, 2 * np.pi, 65), indexing="ij")
    points = 0.3 * np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1)
    row, column = (part.ravel() for part in np.indices((32, 64)))
    corner = row * 65 + column
    faces = np.concatenate(
        [np.stack([corner, corner + 65, corner + 1], 1), np.stack([corner + 1, corner + 65, corner + 66], 1)]
    )
    mesh = mi.Mesh("ball", 33 * 65, len(faces), has_vertex_texcoords=True)
    values = mi.traverse(mesh)
    values["vertex_positions"] = points.astype(np.float32).ravel()
    values["faces"] = faces.astype(np.uint32).ravel()
    values["vertex_texcoords"] = np.stack([u, v], axis=-1).astype(np.float32).ravel()
    values.update()
    mesh.write_ply(str(file))


@pytest.mark.parametrize(
    ("formula", "pieces"),
    [(["x", "y", "z"], 1), (["x", "y + 0.4 * t", "z"], 1), (["x", "y + t * x**2", "z"], 256)],
)
def test_what_deforms_has_as_many_pieces_as_it_requires(tmp_path, formula, pieces):
    """A cube has eight vertices in different places, and many points on its faces."""
    scene = loaded(tmp_path, {"shapes": {"left": {"formula": formula}}})
    assert scene.moving is not None
    courses = scene.moving.courses(5)
    assert {course.name for course in courses} == {"left"}
    assert len({tuple(course.centre) for course in courses}) == pieces


QUAD = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]


def test_a_quad_is_taken_to_more_pieces_than_it_has_vertices(tmp_path):
    """Each piece goes where a point of the sheet between its four corners goes."""
    file = '<string name="filename" value="q.ply"/>'
    xml = XML.replace("cube", "ply", 1).replace('id="left">', f'id="left">{file}')
    write_mesh(tmp_path / "q.ply", np.array([[0, 1, 2], [0, 2, 3]]), np.array(QUAD, dtype=float))
    scene = loaded(tmp_path, {"shapes": {"left": {"formula": ["x * (1 + t)", "y", "z"]}}}, xml)
    assert scene.moving is not None
    courses = scene.moving.courses(3)
    assert len(courses) == 256
    for course in courses:
        np.testing.assert_allclose(course.shifts[-1], [course.centre[0], 0, 0], atol=1e-6)


def test_all_shapes_of_a_scene_may_move(tmp_path):
    start, end = XML.index('<shape type="cube" id="right"'), XML.index("<emitter")
    scene = loaded(tmp_path, {"shapes": {"left": RIGHT}}, XML[:start] + XML[end:])
    assert scene.moving is not None
    assert len(scene.mitsuba.shapes()) == 1
    before = hits(scene)
    scene.set_time(1.0)
    assert (hits(scene) != before).any()


def radiance(scene: Scene) -> np.ndarray:
    traced = Tracer(scene).trace(scene.camera, frame_positions(scene.camera), 16)
    return np.stack([channel.numpy() for channel in traced.radiance])


@extreme(
    "a shape that flies far away",
    given="translated by 1e6 times its distance",
    expected="a finite frame that does not show it",
)
def test_a_shape_may_leave_the_scene(tmp_path, got):
    scene = loaded(tmp_path, {"shapes": {"right": keys({"t": 0}, {"t": 1, "translate": [0, 4e6, 0]})}})
    scene.set_time(1.0)
    shown = int((np.abs(hits(scene) - [1, 0, 0]) < 0.31).all(axis=1).sum())
    assert got(shown) == 0
    assert np.isfinite(radiance(scene)).all()


@extreme(
    "a shape that collapses to a point",
    given="a formula that gives all vertices one place",
    expected="a finite frame that does not show it",
)
def test_a_shape_may_vanish(tmp_path, got):
    scene = loaded(
        tmp_path, {"shapes": {"right": {"formula": ["1 + (x - 1) * (1 - t)", "y * (1 - t)", "z * (1 - t)"]}}}
    )
    scene.set_time(1.0)
    points = hits(scene)
    shown = int((np.abs(points - [1, 0, 0]) < 0.1).all(axis=1).sum())
    assert got(shown) == 0
    assert np.isfinite(radiance(scene)).all()


@extreme("a light that goes out", given="factor 0 for the only light", expected="black, and finite")
def test_the_only_light_may_go_out(tmp_path, got):
    scene = loaded(tmp_path, {"lights": {"lamp": keys({"t": 0}, {"t": 1, "factor": 0})}})
    assert radiance(scene).max() > 0.1
    scene.set_time(1.0)
    assert got(float(radiance(scene).max())) == 0


@extreme(
    "a shape that turns a million times",
    given="degrees 3.6e8 from t = 0 to 1",
    expected="at t = 1 where it was, to 1e-4",
)
def test_a_shape_may_turn_any_number_of_times(tmp_path, got):
    track = keys({"t": 0}, {"t": 1, "degrees": 3.6e8}, about=[1, 0, 0])
    scene = loaded(tmp_path, {"shapes": {"right": track}})
    before = hits(scene)
    scene.set_time(1.0)
    assert got(float(np.abs(hits(scene) - before).max()), ".1g") < 1e-4


@extreme("a motion file cut in half", given="the first half of its bytes", expected="refused in one line")
def test_a_damaged_motion_is_refused(tmp_path, got):
    loaded(tmp_path, {"shapes": {"right": RIGHT}})
    file = tmp_path / "box.motion.json"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(UserError, match="cannot be read") as refused:
        load_scene(tmp_path / "box.xml")
    assert "\n" not in got(str(refused.value).replace(str(tmp_path), ""))
