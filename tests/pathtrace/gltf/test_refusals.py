"""What is wrong with a file is one line that names it, and nothing is left behind."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.gltf.document import read_document
from pathtrace.gltf.importing import import_gltf
from tests.extremes import extreme
from tests.pathtrace.gltf.building import BOX, BOX_FACES, QUAD, QUAD_FACES, Building, bending_tube

pytestmark = pytest.mark.usefixtures("backend")


def box():
    building = Building()
    node = building.node(mesh=building.mesh(BOX, BOX_FACES), name="box")
    building.animation((node, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], "LINEAR"), name="go")
    return building


def refusal(file, folder, **options):
    """What the import says; nothing may be left behind."""
    before = sorted(folder.iterdir())
    with pytest.raises(UserError) as error:
        import_gltf(read_document(file), folder / "scene", **options)
    assert sorted(folder.iterdir()) == before
    message = str(error.value)
    assert "\n" not in message
    return message


CHANGES = {
    "asset": (lambda t: t["asset"].update(version="1.0"), "is no glTF 2.0; its asset.version is '1.0'"),
    "draco": (
        lambda t: t.update(extensionsRequired=["KHR_draco_mesh_compression"]),
        "requires the extension KHR_draco_mesh_compression, which is not known here",
    ),
    "required": (lambda t: t.update(extensionsRequired=5), "is damaged (TypeError"),
    "schema": (lambda t: t["nodes"][0].update(rotation=[0, 0, 1]), "nodes[0].rotation must contain"),
    "mesh": (lambda t: t["nodes"][0].update(mesh=7), "nodes[0] refers to meshes[7]; there are 1"),
    "channel": (
        lambda t: t["animations"][0]["channels"][0]["target"].update(node=9),
        "animation go: channels[0] refers to nodes[9]; there are 1",
    ),
    "sampler": (
        lambda t: t["animations"][0]["channels"][0].update(sampler=4),
        "animation go: channels[0] refers to samplers[4], which does not exist",
    ),
    "interpolation": (
        lambda t: t["animations"][0]["samplers"][0].update(interpolation="SOFT"),
        "has the interpolation SOFT; must be LINEAR, STEP or CUBICSPLINE",
    ),
    "spline": (
        lambda t: t["animations"][0]["samplers"][0].update(interpolation="CUBICSPLINE"),
        "has 2 values for 2 keyframes",
    ),
    "ancestor": (lambda t: t["nodes"][0].update(children=[0]), "nodes[0] is its own ancestor"),
    "parents": (
        lambda t: t["nodes"].extend([{"children": [0]}, {"children": [0]}]),
        "nodes[0] has two parents",
    ),
    "scene": (lambda t: t.update(scene=3, scenes=[{"nodes": [0]}]), "scene refers to scenes[3]"),
    "nothing": (lambda t: t["nodes"][0].pop("mesh"), "shows no triangles"),
    "material": (
        lambda t: t["meshes"][0]["primitives"][0].update(material=2),
        "the material of box refers to materials[2]; there are 0",
    ),
    "positions": (
        lambda t: t["meshes"][0]["primitives"][0].update(attributes={"NORMAL": 0}),
        "meshes[0].primitives[0] has no POSITION",
    ),
    "lights": (
        lambda t: t["nodes"][0].update(extensions={"KHR_lights_punctual": {"light": 1}}),
        "nodes[0] has the light 1; there are 0",
    ),
    "extension": (
        lambda t: (
            t["nodes"][0].update(extensions={"KHR_lights_punctual": {"light": 0}}),
            t.update(extensions={"KHR_lights_punctual": {"lights": ["sun"]}}),
        ),
        "is damaged (AttributeError",
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_wrong_is_named(name, tmp_path):
    building, (change, said) = box(), CHANGES[name]
    change(building.tree)
    message = refusal(building.save(tmp_path / "a.gltf"), tmp_path)
    assert message.startswith(f"{tmp_path / 'a.gltf'}: ")
    assert said in message


@pytest.mark.parametrize(
    ("uri", "said"),
    [
        ("gone.bin", "buffers[0]: 'gone.bin' cannot be read (No such file"),
        ("../secret.bin", "lies outside of the folder"),
        ("https://example.org/a.bin", "cannot be read"),
        ("data:application/octet-stream;base64,AAAA", "buffers[0] has 3 bytes of 588"),
        ("data:nonsense", "cannot be read"),
        (None, "buffers[0] is missing"),
    ],
)
def test_missing_buffers_are_named(uri, said, tmp_path):
    (tmp_path / "secret.bin").write_bytes(bytes(10_000))
    folder = tmp_path / "models"
    folder.mkdir()
    file = box().save(folder / "a.gltf")
    tree = json.loads(file.read_text())
    tree["buffers"][0] = {"byteLength": 588} if uri is None else {"byteLength": 588, "uri": uri}
    file.write_text(json.dumps(tree))
    assert said in refusal(file, folder)


def test_buffers_may_be_files(tmp_path):
    building = box()
    file = building.save(tmp_path / "a.gltf")
    tree = json.loads(file.read_text())
    (tmp_path / "a b.bin").write_bytes(building.content)
    tree["buffers"][0]["uri"] = "a%20b.bin"
    file.write_text(json.dumps(tree))
    assert import_gltf(read_document(file), tmp_path / "scene").rigid == 1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "cannot be read as glTF"),
        (b"{", "cannot be read as glTF"),
        (b"[]", "is no glTF 2.0"),
        (b"glTF", "cannot be read as glTF"),
        (struct.pack("<4sII", b"glTF", 1, 12), "version 1; must be 2"),
        (struct.pack("<4sII", b"glTF", 2, 99), "12 bytes of 99"),
        (struct.pack("<4sII", b"glTF", 2, 12), "has no JSON"),
        (b'{"asset": {"version": "2.0"}}', "shows no triangles"),
        (b'{"asset": {"version": "2.0"}, "nodes": [{"scale": [1e999, 1, 1]}]}', "too large a number"),
    ],
)
def test_what_is_no_gltf_is_refused(content, said, tmp_path):
    file = tmp_path / "a.glb"
    file.write_bytes(content)
    assert said in refusal(file, tmp_path)


def test_a_folder_with_something_in_it_is_kept(tmp_path):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "mine.txt").write_text("mine")
    assert "exists already" in refusal(box().save(tmp_path / "a.glb"), tmp_path)
    assert (tmp_path / "scene" / "mine.txt").read_text() == "mine"


def test_animations_are_listed_where_none_has_the_name(tmp_path):
    message = refusal(box().save(tmp_path / "a.glb"), tmp_path, animation="fly")
    assert message.endswith("has no such animation; it has go")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t["skins"][0].update(joints=[0, 44]), "skins[0] refers to nodes[44]; there are 3"),
        (lambda t: t["skins"][0].update(joints=[0]), "has a joint of 1; skins[0] has 1"),
        (
            lambda t: t["meshes"][0]["primitives"][0]["attributes"].pop("WEIGHTS_0"),
            "nodes[2] has JOINTS without WEIGHTS",
        ),
        (lambda t: t["skins"][0].update(inverseBindMatrices=1), "accessors[1] of skins[0]"),
    ],
)
def test_broken_skins_are_named(change, said, tmp_path):
    building = Building()
    bending_tube(building)
    change(building.tree)
    assert said in refusal(building.save(tmp_path / "a.glb"), tmp_path)


@extreme("degenerate mesh in glTF", given="triangles whose corners are one point", expected="refused by name")
def test_a_mesh_without_area_is_refused(tmp_path, got):
    building = Building()
    building.node(mesh=building.mesh(np.ones((4, 3)), QUAD_FACES))
    said = got(refusal(building.save(tmp_path / "a.glb"), tmp_path).partition(": ")[2])
    assert said.startswith("shows no triangles; meshes[0].primitives[0] has no triangle with an area")


@extreme(
    "one degenerate mesh in glTF",
    given="a box beside a mesh of a point, and one of NaN",
    expected="the box, and a remark for each",
)
def test_degenerate_meshes_are_left_out(tmp_path, got):
    building = Building()
    for vertices, faces in ((np.ones((4, 3)), QUAD_FACES), (BOX, BOX_FACES), (QUAD, QUAD_FACES)):
        building.node(mesh=building.mesh(vertices, faces))
    broken = building.view(np.full((4, 3), np.nan, "<f4").tobytes())
    building.tree["accessors"][-2].update(bufferView=broken)
    found = import_gltf(read_document(building.save(tmp_path / "a.gltf")), tmp_path / "scene")
    assert found.triangles == len(BOX_FACES)
    assert got("; ".join(found.remarks[:2])) == (
        "meshes[0].primitives[0] has no triangle with an area, and is left out; "
        "meshes[2].primitives[0] holds numbers that are not finite, and is left out"
    )


@extreme("glTF vertices at 1e30", given="a box of 1e30", expected="refused in one line")
def test_what_is_beyond_float32_is_refused(tmp_path, got):
    building = Building()
    building.node(mesh=building.mesh(BOX * 1e30, BOX_FACES))
    message = refusal(building.save(tmp_path / "a.glb"), tmp_path)
    assert got(message.partition(": ")[2]).endswith("vertices are too far from the origin)")


@extreme("glTF animation of a year", given="keyframes at 0 and 3e7 s", expected="refused, naming --fps")
def test_an_endless_animation_is_refused(tmp_path, got):
    building = Building()
    node = building.node(mesh=building.mesh(BOX, BOX_FACES))
    building.animation((node, "scale", [0, 3e7], [[1, 1, 1], [2, 1, 1]], "LINEAR"))
    message = refusal(building.save(tmp_path / "a.glb"), tmp_path)
    assert got(message) == "fps 24: an animation of 30,000,000 s and 1 nodes is too long"


@extreme("glTF that deforms too much", given="30,000 vertices over 1,000 s", expected="refused, naming --fps")
def test_too_many_meshes_are_refused(tmp_path, got):
    building = Building()
    vertices = np.tile(QUAD, (7500, 1))
    node = building.node(mesh=building.mesh(vertices, QUAD_FACES))
    building.animation((node, "scale", [0, 1000], [[1, 1, 1], [2, 1, 1]], "LINEAR"))
    message = refusal(building.save(tmp_path / "a.glb"), tmp_path)
    assert got(message).startswith("fps: what deforms would have 720,030,000 vertices")


@extreme("glTF box that grows from nothing", given="scale 0 at time 0", expected="a sequence of meshes")
def test_what_has_no_size_at_first_deforms(tmp_path, got):
    building = Building()
    node = building.node(mesh=building.mesh(BOX, BOX_FACES))
    building.animation((node, "scale", [0, 1], [[0, 0, 0], [2, 2, 2]], "LINEAR"))
    found = import_gltf(read_document(building.save(tmp_path / "a.glb")), tmp_path / "scene")
    assert got(found.deforming) == 1
