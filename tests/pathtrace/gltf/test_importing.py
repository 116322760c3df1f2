"""Imported scenes: their vertices at times, against plain formulas, and what they are made of."""

from __future__ import annotations

import io
import json
import xml.etree.ElementTree as ET
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from pathtrace.gltf.document import read_document
from pathtrace.gltf.importing import import_gltf
from pathtrace.scene.scene import load_scene
from tests.pathtrace.gltf.building import (
    BOX,
    BOX_FACES,
    QUAD,
    QUAD_FACES,
    Building,
    bending_tube,
    quaternion,
    tube,
)

pytestmark = pytest.mark.usefixtures("backend")

TIMES = (0.0, 0.3, 0.5, 0.85, 1.0)


def imported(building, folder, **options):
    """A file, imported and loaded; what was said of it."""
    found = import_gltf(read_document(building.save(folder / "a.glb")), folder / "scene", **options)
    return load_scene(found.scene.parent), found


def vertices(scene, name, time):
    """(V, 3) of a shape that moves, or of the only one, at a time."""
    scene.show(time)
    if scene.moving is None:
        (shape,) = scene.mitsuba.shapes()
    else:
        shape = dict(zip(scene.moving.motion.shapes, scene.moving.shapes, strict=True))[name]
    positions = np.reshape(mi.traverse(shape)["vertex_positions"].numpy(), (-1, 3)).astype(np.float64)
    return positions * scene.place.unit + np.array(scene.place.origin)


@pytest.mark.parametrize(
    ("light", "cone"),
    [
        # A quarter turn in float32 is a little more.
        (
            {"type": "spot", "spot": {"innerConeAngle": 0.7, "outerConeAngle": float(np.float32(np.pi / 2))}},
            (40.107, 90),
        ),
        ({"type": "spot", "spot": {"innerConeAngle": 0.5, "outerConeAngle": 0.5}}, (28.619, 28.648)),
        ({"type": "point", "spot": None}, None),
    ],
)
def test_cones_are_clamped_to_what_a_spot_can_be(tmp_path, light, cone):
    building = Building()
    still_floor(building)
    building.tree["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    building.node(name="lamp", extensions={"KHR_lights_punctual": {"light": 0}})
    scene, _ = imported(building, tmp_path)
    root = ET.parse(tmp_path / "scene" / "scene.xml").getroot()
    (emitter,) = root.findall("emitter")
    numbers = {one.get("name"): float(one.get("value")) for one in emitter.findall("float")}
    expected = {} if cone is None else {"beam_width": cone[0], "cutoff_angle": cone[1]}
    assert numbers == pytest.approx(expected, abs=1e-3)
    assert len(scene.mitsuba.emitters()) == 1


def test_a_folder_that_is_there_stays_and_so_do_links_to_it(tmp_path, monkeypatch):
    building = Building()
    still_floor(building)
    file = building.save(tmp_path / "a.glb")
    (tmp_path / "here").mkdir()
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to("disk")
    monkeypatch.chdir(tmp_path / "here")
    for folder, place in ((Path(), tmp_path / "here"), (tmp_path / "link", tmp_path / "disk")):
        before = place.stat().st_ino
        import_gltf(read_document(file), folder)
        assert place.stat().st_ino == before
        assert (place / "scene.xml").is_file()
        assert not [one for one in place.iterdir() if one.name.startswith(".")]
    assert (tmp_path / "link").is_symlink()


def test_files_may_be_links_named_as_windows_does_and_animations_empty(tmp_path):
    building = Building()
    still_floor(building)
    building.add("animations", name="nothing", channels=[], samplers=[])
    file = building.save(tmp_path / "a.gltf")
    tree = json.loads(file.read_text())
    (tmp_path / "store").write_bytes(building.content)
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "data").mkdir()
    (tmp_path / "scene" / "data" / "a b.bin").symlink_to(tmp_path / "store")
    tree["buffers"][0]["uri"] = "data\\a b.bin"
    (tmp_path / "scene" / "a.gltf").write_text(json.dumps(tree))
    found = import_gltf(read_document(tmp_path / "scene" / "a.gltf"), tmp_path / "out")
    assert (found.triangles, found.seconds) == (2, 0)


@pytest.mark.parametrize(
    ("times", "values", "remark", "starts", "ends"),
    [
        ([-1, 0, 1], [[9, 0, 0], [0, 0, 0], [1, 0, 0]], "starts before 0", 0, 1),
        ([0, 1, 1, 2], [[0, 0, 0], [1, 0, 0], [5, 0, 0], [6, 0, 0]], "keyframes at the same time", 0, 6),
    ],
)
def test_keyframes_of_others_are_played_from_0_and_once_a_time(tmp_path, times, values, remark, starts, ends):
    building = Building()
    node = building.node(mesh=building.mesh(QUAD, QUAD_FACES), name="quad")
    building.animation((node, "translation", times, values, "LINEAR"))
    scene, found = imported(building, tmp_path)
    assert any(remark in one for one in found.remarks)
    for time, shift in ((0.0, starts), (1.0, ends)):
        np.testing.assert_allclose(vertices(scene, "quad", time), np.add(QUAD, [shift, 0, 0]), atol=1e-4)


def still_floor(building):
    building.node(mesh=building.mesh(QUAD * 4, QUAD_FACES), name="floor", translation=[0, 0, -3])


def turned(points, axis, degrees, about=(0, 0, 0)):
    rotation = Rotation.from_rotvec(np.radians(degrees) * np.array(axis)).as_matrix()
    return (points - np.array(about)) @ rotation.T + np.array(about)


def test_a_skinned_tube_bends(tmp_path):
    building = Building()
    bending_tube(building)
    still_floor(building)
    scene, found = imported(building, tmp_path)
    assert (found.rigid, found.deforming, found.seconds) == (0, 1, 1.0)
    rest, _, up = tube()
    for time in TIMES:
        bent = turned(rest, (0, 0, 1), 90 * time, about=(0, 1, 0))
        wanted = (1 - up)[:, None] * rest + up[:, None] * bent
        # Between the meshes of 24 moments a second, vertices go straight.
        np.testing.assert_allclose(vertices(scene, "tube", time), wanted, atol=2e-3)
    for step in (0, 6, 17, 24):
        bent = turned(rest, (0, 0, 1), 90 * step / 24, about=(0, 1, 0))
        wanted = (1 - up)[:, None] * rest + up[:, None] * bent
        np.testing.assert_allclose(vertices(scene, "tube", step / 24), wanted, atol=1e-5)


def local(item, turn=None):
    """(4, 4) of a node, turned by a quaternion of its own or by another one."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(turn or item["rotation"]).as_matrix() * item["scale"]
    matrix[:3, 3] = item["translation"]
    return matrix


def test_morphed_vertices_follow_many_joints_of_scaled_parents(tmp_path):
    rng, building = np.random.default_rng(3), Building()
    target = 0.1 * rng.normal(size=BOX.shape)
    which = rng.integers(0, 3, (2, 8, 4))
    shares = rng.random((2, 8, 4))
    shares /= shares.sum(axis=(0, 2), keepdims=True)
    chain = [
        {
            "translation": rng.normal(size=3).tolist(),
            "rotation": Rotation.random(random_state=number).as_quat().tolist(),
            "scale": rng.uniform(0.7, 1.3, 3).tolist(),
        }
        for number in range(3)
    ]
    joints = [building.node(**item) for item in chain]
    for parent in (0, 1):
        building.tree["nodes"][parent]["children"] = [parent + 1]
    inverse = np.tile(np.eye(4), (3, 1, 1))
    inverse[:, :3] += 0.2 * rng.normal(size=(3, 3, 4))
    matrices = building.array(inverse.transpose(0, 2, 1).reshape(3, 16))
    skin = building.add("skins", joints=joints, inverseBindMatrices=matrices)
    sets = {f"JOINTS_{n}": building.array(which[n], "uint16") for n in (0, 1)}
    sets |= {f"WEIGHTS_{n}": building.array(shares[n]) for n in (0, 1)}
    mesh = building.mesh(BOX, BOX_FACES, [target], weights=[0.0], **sets)
    node = building.node(mesh=mesh, skin=skin, name="box")
    turns = [chain[1]["rotation"], quaternion((1, 2, 3), 100)]
    building.animation(
        (1, "rotation", [0, 1], turns, "LINEAR"), (node, "weights", [0, 1], [0.0, 2.0], "LINEAR")
    )
    scene, _ = imported(building, tmp_path, fps=4)
    # At the end, which is no rounding of anything between.
    to_world = np.eye(4)
    for number, item in enumerate(chain):
        to_world = to_world @ local(item, turns[1] if number == 1 else None)
        chain[number] = to_world @ inverse[number]
    wanted = np.zeros_like(BOX)
    for vertex, rest in enumerate(BOX + 2.0 * target):
        for joint, share in zip(which[:, vertex].ravel(), shares[:, vertex].ravel(), strict=True):
            wanted[vertex] += share * (chain[joint] @ [*rest, 1])[:3]
    np.testing.assert_allclose(vertices(scene, "box", 1.0), wanted, atol=1e-5)


def test_more_meshes_a_second_are_nearer(tmp_path):
    building = Building()
    bending_tube(building)
    rest, _, up = tube()
    errors = []
    for fps in (2, 8, 60):
        (tmp_path / str(fps)).mkdir()
        scene, _ = imported(building, tmp_path / str(fps), fps=fps)
        errors.append(0.0)
        for time in np.linspace(0, 1, 23):
            bent = turned(rest, (0, 0, 1), 90 * time, about=(0, 1, 0))
            wanted = (1 - up)[:, None] * rest + up[:, None] * bent
            errors[-1] = max(errors[-1], np.abs(vertices(scene, "tube", time) - wanted).max())
    assert errors[0] > 4 * errors[1] > 16 * errors[2]


def test_a_quad_morphs_by_weights_that_a_spline_moves(tmp_path):
    building = Building()
    lift, stretch = np.zeros((4, 3)), np.zeros((4, 3))
    lift[2:, 2], stretch[:2, 0] = 1, [-1, 1]
    mesh = building.mesh(QUAD, QUAD_FACES, [lift, stretch], weights=[0.25, 0.0])
    node = building.node(mesh=mesh, name="quad", scale=[2, 1, 1], translation=[0, 5, 0])
    # In-tangent, value, out-tangent of both weights at each keyframe.
    keys = [[0, 0], [0, 1], [1, 0], [-2, 0], [1, 0], [0, 0]]
    building.animation((node, "weights", [0, 2], np.ravel(keys), "CUBICSPLINE"))
    still_floor(building)
    scene, found = imported(building, tmp_path, fps=48)
    assert (found.rigid, found.deforming, found.seconds) == (0, 1, 2.0)
    for t in TIMES:
        values = 3 * t**2 - 2 * t**3, 2 * t**3 - 3 * t**2 + 1
        lifted = values[0] + 2 * (t**3 - 2 * t**2 + t) - 2 * 2 * (t**3 - t**2)
        wanted = (QUAD + lifted * lift + values[1] * stretch) * [2, 1, 1] + [0, 5, 0]
        np.testing.assert_allclose(vertices(scene, "quad", t), wanted, atol=1e-3)


def test_weights_that_nothing_moves_are_those_of_the_node(tmp_path):
    building = Building()
    lift = np.zeros((4, 3))
    lift[:, 2] = 1
    mesh = building.mesh(QUAD, QUAD_FACES, [lift], weights=[0.25])
    building.node(mesh=mesh, name="own", weights=[0.5])
    building.node(mesh=mesh, name="default", translation=[3, 0, 0])
    import_gltf(read_document(building.save(tmp_path / "a.gltf")), tmp_path / "scene")
    for name, height in (("own", 0.5), ("default", 0.25)):
        shape = mi.load_dict({"type": "ply", "filename": str(tmp_path / f"scene/meshes/{name}.ply")})
        positions = np.reshape(mi.traverse(shape)["vertex_positions"].numpy(), (-1, 3))
        np.testing.assert_allclose(positions[:, 2], height)


def test_a_box_on_an_arm_turns_rigidly(tmp_path):
    building = Building()
    arm = building.node(
        mesh=building.mesh(BOX, BOX_FACES), name="box", translation=[4, 0, 0], scale=[1, 2, 1]
    )
    hub = building.node(children=[arm], translation=[0, 1, 0], scale=[0.5, 0.5, 0.5])
    turns = [quaternion((0, 1, 0), angle) for angle in (0, 120, 240, 360)]
    building.animation(
        (hub, "rotation", [0, 1, 2, 3], turns, "LINEAR"),
        (hub, "translation", [0, 3], [[0, 1, 0], [0, 4, 0]], "LINEAR"),
    )
    building.tree["scenes"] = [{"nodes": [hub]}]
    scene, found = imported(building, tmp_path)
    assert (found.rigid, found.deforming, found.seconds) == (1, 0, 3.0)
    (track,) = json.loads((tmp_path / "scene/scene.motion.json").read_text())["shapes"].values()
    assert len(track["keyframes"]) < 12
    for time in TIMES:
        wanted = turned((BOX * [1, 2, 1] + [4, 0, 0]) * 0.5, (0, 1, 0), 360 * time) + np.array(
            [0, 1 + 3 * time, 0]
        )
        np.testing.assert_allclose(vertices(scene, "box", time), wanted, atol=3e-3)


def test_a_box_that_grows_is_a_sequence_of_meshes(tmp_path):
    building = Building()
    node = building.node(mesh=building.mesh(BOX, BOX_FACES), name="box")
    building.animation((node, "scale", [0, 1], [[1, 1, 1], [3, 1, 2]], "LINEAR"))
    scene, found = imported(building, tmp_path)
    assert (found.rigid, found.deforming) == (0, 1)
    for time in TIMES:
        wanted = BOX * [1 + 2 * time, 1, 1 + time]
        np.testing.assert_allclose(vertices(scene, "box", time), wanted, atol=1e-5)


def test_steps_jump(tmp_path):
    building = Building()
    node = building.node(mesh=building.mesh(BOX, BOX_FACES), name="box")
    building.animation((node, "translation", [0, 1, 2], [[0, 0, 0], [5, 0, 0], [5, 7, 0]], "STEP"))
    still_floor(building)
    scene, _ = imported(building, tmp_path)
    for time, shift in ((0.0, (0, 0, 0)), (0.4999, (0, 0, 0)), (0.5, (5, 0, 0)), (0.9999, (5, 0, 0))):
        np.testing.assert_allclose(vertices(scene, "box", time), BOX + shift, atol=1e-4)


def test_a_light_follows_its_node(tmp_path):
    building = Building()
    still_floor(building)
    building.tree["extensions"] = {
        "KHR_lights_punctual": {
            "lights": [
                {"type": "point", "color": [1, 0.5, 0], "intensity": 4},
                {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.5}},
                {"type": "directional"},
            ]
        }
    }
    light = [{"KHR_lights_punctual": {"light": number}} for number in range(3)]
    bulb = building.node(extensions=light[0], name="bulb", translation=[1, 2, 3])
    building.node(extensions=light[1], name="lamp", translation=[0, 0, 2])
    sun = building.node(extensions=light[2], name="sun")
    building.animation(
        (bulb, "translation", [0, 1], [[1, 2, 3], [2, 2, 3]], "LINEAR"),
        (sun, "rotation", [0, 1], [[0, 0, 0, 1], quaternion((0, 1, 0), 90)], "LINEAR"),
    )
    scene, found = imported(building, tmp_path)
    assert found.rigid == 2
    assert not any("no lights" in line for line in found.remarks)
    scene.show(0.5)
    kinds = {"PointLight": "bulb", "SpotLight": "lamp", "DirectionalEmitter": "sun"}
    by_name = {kinds[light.class_name()]: mi.traverse(light) for light in scene.mitsuba.emitters()}
    np.testing.assert_allclose(np.ravel(by_name["bulb"]["position"]), [1.5, 2, 3], atol=1e-5)
    np.testing.assert_allclose(np.ravel(by_name["bulb"]["intensity.value"]), [4, 2, 0])
    sun_direction = np.array(by_name["sun"]["to_world"].matrix).reshape(4, 4)[:3, 2]
    np.testing.assert_allclose(sun_direction, [-np.sqrt(0.5), 0, -np.sqrt(0.5)], atol=1e-5)
    lamp_direction = np.array(by_name["lamp"]["to_world"].matrix).reshape(4, 4)[:3, 2]
    np.testing.assert_allclose(lamp_direction, [0, 0, -1], atol=1e-6)


def test_lights_far_too_bright_are_dimmed_together(tmp_path):
    building = Building()
    building.node(mesh=building.mesh(QUAD, QUAD_FACES))
    building.tree["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 54000}]}}
    building.node(extensions={"KHR_lights_punctual": {"light": 0}}, translation=[0, 0, 3], name="bulb")
    scene, found = imported(building, tmp_path)
    (emitter,) = scene.mitsuba.emitters()
    np.testing.assert_allclose(np.ravel(mi.traverse(emitter)["intensity.value"]), 9 * np.pi, rtol=1e-5)
    assert any(line.startswith("lights are dimmed") for line in found.remarks)


def test_the_camera_is_that_of_the_file(tmp_path):
    building = Building()
    building.node(mesh=building.mesh(QUAD, QUAD_FACES))
    lens = {"yfov": np.radians(40), "aspectRatio": 1.5, "znear": 0.1}
    camera = building.add("cameras", type="perspective", perspective=lens)
    building.node(camera=camera, translation=[0, 0, 5], scale=[2, 2, 2])
    scene, _ = imported(building, tmp_path)
    assert (scene.camera.width, scene.camera.height) == (768, 512)
    assert scene.camera.fy == pytest.approx(256 / np.tan(np.radians(20)), rel=1e-5)
    wanted = np.diag([1.0, -1.0, -1.0, 1.0])
    wanted[2, 3] = 5
    np.testing.assert_allclose(scene.camera.camera_to_world, wanted, atol=1e-5)


def test_without_a_camera_everything_is_seen_from_the_front_at_all_times(tmp_path):
    building = Building()
    node = building.node(mesh=building.mesh(BOX, BOX_FACES), name="box")
    building.animation((node, "translation", [0, 1], [[0, 0, 0], [30, 0, -5]], "LINEAR"))
    scene, found = imported(building, tmp_path)
    assert any("no lights" in line for line in found.remarks)
    to_camera = np.linalg.inv(scene.camera.camera_to_world)
    for time in (0, 1):
        points = (vertices(scene, "box", time) - np.array(scene.place.origin)) / scene.place.unit
        x, y, z = (points @ to_camera[:3, :3].T + to_camera[:3, 3]).T
        camera = scene.camera
        assert (z > 0).all()
        for along, focal, middle, size in (
            (x, camera.fx, camera.cx, camera.width),
            (y, camera.fy, camera.cy, camera.height),
        ):
            assert ((along / z * focal + middle > 0) & (along / z * focal + middle < size)).all()


def test_materials_are_principled(tmp_path):
    building = Building()
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[0, 0], pixels[1, 1] = (255, 0, 0, 255), (0, 255, 0, 100)
    content = io.BytesIO()
    Image.fromarray(pixels).save(content, "PNG")
    building.add("images", bufferView=building.view(content.getvalue()), mimeType="image/png")
    building.add("textures", source=0)
    building.add(
        "materials", pbrMetallicRoughness={"baseColorFactor": [0.2, 0.4, 0.6, 1], "roughnessFactor": 0.3}
    )
    building.add(
        "materials",
        pbrMetallicRoughness={"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 0}},
        alphaMode="MASK",
    )
    building.add(
        "materials",
        emissiveFactor=[1, 0.5, 0],
        extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 6}},
    )
    uvs = building.array([[0, 1], [1, 1], [1, 0], [0, 0]])
    colours = building.array([[0.5, 1, 1]] * 4)
    for number, more in enumerate(({}, {"TEXCOORD_0": uvs}, {}, {"COLOR_0": colours})):
        material = {"material": number} if number < 3 else {}
        building.node(
            mesh=building.mesh(QUAD, QUAD_FACES, **material, **more),
            name=f"q{number}",
            translation=[3 * number, 0, 0],
        )
    imported(building, tmp_path)
    root = ET.parse(tmp_path / "scene/scene.xml").getroot()
    bsdfs = {element.attrib["id"]: element for element in root.findall("bsdf")}
    values = {e.attrib["name"]: e.attrib["value"] for e in bsdfs["material-0"].find("bsdf")}
    assert values == {"base_color": "0.2, 0.4, 0.6", "roughness": "0.3", "metallic": "1"}
    assert bsdfs["material-1"].attrib["type"] == "mask"
    opacity = bsdfs["material-1"].find("texture/string[@name='filename']").attrib["value"]
    np.testing.assert_array_equal(np.array(Image.open(tmp_path / "scene" / opacity)), [[255, 0], [0, 0]])
    (base,) = bsdfs["material-1"].findall(".//texture[@name='base_color']/string[@name='filename']")
    written = np.array(Image.open(tmp_path / "scene" / base.attrib["value"]))
    np.testing.assert_array_equal(written, pixels[..., :3])
    (shining,) = root.findall("shape/emitter/rgb")
    assert shining.attrib["value"] == "6, 3, 0"
    assert bsdfs["material-default-coloured"].find("bsdf/texture").attrib["type"] == "mesh_attribute"


def test_the_top_of_an_image_is_where_v_is_zero(tmp_path):
    building = Building()
    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:4] = 255
    content = io.BytesIO()
    Image.fromarray(pixels).save(content, "PNG")
    building.add("images", bufferView=building.view(content.getvalue()), mimeType="image/png")
    building.add("textures", source=0)
    building.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}, "metallicFactor": 0})
    uvs = building.array([[0, 1], [1, 1], [1, 0], [0, 0]])
    building.node(mesh=building.mesh(QUAD, QUAD_FACES, material=0, TEXCOORD_0=uvs))
    scene, _ = imported(building, tmp_path)
    picture = np.array(mi.render(scene.mitsuba, integrator=mi.load_dict({"type": "path"}), spp=4))
    height, width = picture.shape[:2]
    above, below = (picture[int(share * height), width // 2, 0] for share in (0.4, 0.6))
    assert above > 0.7
    assert below < 0.2


def test_a_file_in_which_nothing_moves_is_a_still_scene(tmp_path):
    building = Building()
    building.node(mesh=building.mesh(BOX, BOX_FACES), name="box", matrix=(2 * np.eye(4)).ravel().tolist())
    building.tree["nodes"][0]["matrix"][15] = 1
    scene, found = imported(building, tmp_path)
    assert (found.rigid, found.deforming, found.seconds, found.triangles) == (0, 0, 0, 12)
    assert scene.moving is None
    np.testing.assert_allclose(vertices(scene, "box", 0), 2 * BOX)


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (1, 2, -3)])
def test_faces_and_normals_point_outwards_however_a_node_mirrors(tmp_path, scale):
    building = Building()
    normals = building.array(BOX / np.sqrt(3))
    building.node(mesh=building.mesh(BOX, BOX_FACES, NORMAL=normals), name="box", scale=list(scale))
    import_gltf(read_document(building.save(tmp_path / "a.glb")), tmp_path / "scene")
    shape = mi.traverse(mi.load_dict({"type": "ply", "filename": str(tmp_path / "scene/meshes/box.ply")}))
    points, written = (
        np.reshape(shape[f"vertex_{kind}"].numpy(), (-1, 3)) for kind in ("positions", "normals")
    )
    corners = points[np.reshape(shape["faces"].numpy(), (-1, 3))]
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("fi,fi->f", outwards, corners.mean(axis=1)) > 0).all()
    wanted = BOX / np.array(scale)
    np.testing.assert_allclose(written, wanted / np.linalg.norm(wanted, axis=1, keepdims=True), atol=1e-6)


def test_strips_and_fans_are_triangles(tmp_path):
    building = Building()
    zigzag = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]]
    building.node(mesh=building.mesh(zigzag, range(5), mode=5), name="strip")
    building.node(mesh=building.mesh(QUAD, range(4), mode=6), name="fan")
    building.node(mesh=building.mesh(QUAD, range(4), mode=1), name="lines")
    found = import_gltf(read_document(building.save(tmp_path / "a.glb")), tmp_path / "scene")
    assert found.triangles == 5
    assert any("points or lines" in line for line in found.remarks)
    for name in ("strip", "fan"):
        shape = mi.load_dict({"type": "ply", "filename": str(tmp_path / f"scene/meshes/{name}.ply")})
        points = np.reshape(mi.traverse(shape)["vertex_positions"].numpy(), (-1, 3))
        faces = np.reshape(mi.traverse(shape)["faces"].numpy(), (-1, 3))
        a, b, c = (points[faces[:, corner]] for corner in range(3))
        assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_animations_that_move_different_things_play_together(tmp_path):
    building = Building()
    box = building.mesh(BOX, BOX_FACES)
    nodes = [building.node(mesh=box, name=name, translation=[4 * i, 0, 0]) for i, name in enumerate("ab")]
    for node, name in zip(nodes, ("first", "second"), strict=True):
        shifts = [[4 * node, 0, 0], [4 * node, 1, 0]]
        building.animation((node, "translation", [0, node + 1], shifts, "LINEAR"), name=name)
    scene, found = imported(building, tmp_path)
    assert (found.rigid, found.seconds) == (2, 2)
    np.testing.assert_allclose(vertices(scene, "a", 0.5), BOX + np.array([0, 1, 0]), atol=1e-5)
    np.testing.assert_allclose(vertices(scene, "b", 0.5), BOX + np.array([4, 0.5, 0]), atol=1e-5)
    chosen = import_gltf(read_document(tmp_path / "a.glb"), tmp_path / "chosen", animation="second")
    assert (chosen.rigid, chosen.seconds) == (1, 2)


def test_of_animations_that_move_the_same_the_first_one_plays(tmp_path):
    building = Building()
    node = building.node(mesh=building.mesh(BOX, BOX_FACES), name="box")
    for name, way in (("walk", 1), ("run", 2)):
        building.animation((node, "translation", [0, 1], [[0, 0, 0], [way, 0, 0]], "LINEAR"), name=name)
    scene, found = imported(building, tmp_path)
    assert "the animation walk plays; --animation chooses from walk, run" in found.remarks
    np.testing.assert_allclose(vertices(scene, "box", 1), BOX + np.array([1, 0, 0]), atol=1e-5)
    import_gltf(read_document(tmp_path / "a.glb"), tmp_path / "running", animation="run")
    np.testing.assert_allclose(
        vertices(load_scene(tmp_path / "running"), "box", 1), BOX + np.array([2, 0, 0]), atol=1e-5
    )


def test_shapes_have_names_of_their_own(tmp_path):
    building = Building()
    mesh = building.mesh(BOX, BOX_FACES)
    for name in ("box", "Box", "box", "camera", "../$x", ""):
        building.node(mesh=mesh, name=name)
    import_gltf(read_document(building.save(tmp_path / "a.glb")), tmp_path / "scene")
    files = sorted(file.name for file in (tmp_path / "scene/meshes").iterdir())
    assert files == sorted(["box.ply", "Box_2.ply", "box_3.ply", "camera_2.ply", "x.ply", "node5.ply"])
