"""Degenerate parts of a scene: they are named and left out, and do not sink the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from tests.extremes import extreme

pytestmark = pytest.mark.usefixtures("backend")

SCENE = """<scene version="3.0.0"><sensor type="perspective"><transform name="to_world">
<lookat origin="0, 0, -4" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/></film></sensor>
<emitter type="constant"/><shape type="sphere"/>{}</scene>"""
MESH = '<shape type="{}"><string name="filename" value="{}"/>{}</shape>'
LAMP = '<emitter type="area"/>'
GROUP = '<shape type="shapegroup" id="g">{}</shape><shape type="instance"><ref id="g"/></shape>'


def ply(vertices: Any, faces: Any) -> bytes:
    """A file of vertices (V, 3) and faces (F, 3)."""
    points, corners = (
        np.array(rows, kind).reshape(-1, 3) for rows, kind in ((vertices, "<f4"), (faces, "<i4"))
    )
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [*(f"property float {axis}" for axis in "xyz"), f"element face {len(corners)}"]
    header += ["property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(header).encode() + points.tobytes() + b"".join(b"\3" + row.tobytes() for row in corners)


def corners(first: float = 0.0) -> list[list[float]]:
    return [[first, 0, -2], [1, 0, -2], [0, 1, -2]]


FACE = [0, 1, 2]
FILES = {
    "good.ply": ply(corners(), FACE),
    "none.ply": ply([], []),
    "points.ply": ply(corners(), []),
    "nan.ply": ply(corners(np.nan), FACE),
    "endless.ply": ply(corners(np.inf), FACE),
    "flat.ply": ply(3 * [[0, 0, -2]], FACE),
    "points.obj": b"v 0 0 -2\nv 1 0 -2\n",
    "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "none.obj": b"",
    "beyond.ply": ply(corners(), [0, 1, 7]),
}


def loaded(folder: Path, content: str) -> Scene:
    for name, content_of in FILES.items():
        (folder / name).write_bytes(content_of)
    (folder / "scene.xml").write_text(SCENE.format(content))
    return load_scene(folder / "scene.xml")


def mesh(name: str, more: str = "") -> str:
    return MESH.format(name.rpartition(".")[2], name, more)


NO_FACES, NOT_FINITE = "has no faces", "has vertices that are not finite"
FAR = '<transform name="to_world"><translate x="nan"/></transform>'
PARTS = {
    "none.ply": (mesh("none.ply"), NO_FACES),
    "points.ply": (mesh("points.ply"), NO_FACES),
    "points.obj": (mesh("points.obj"), NO_FACES),
    "none.obj": (mesh("none.obj"), NO_FACES),
    "nan.ply": (mesh("nan.ply"), NOT_FINITE),
    "endless.ply": (mesh("endless.ply"), NOT_FINITE),
    "nan.obj": (mesh("nan.obj"), NOT_FINITE),
    "light": (mesh("nan.ply", LAMP), NOT_FINITE),
    "in a group": (GROUP.format(mesh("points.ply")), NO_FACES),
    "beside another in a group": (GROUP.format(mesh("nan.ply") + mesh("good.ply")), NOT_FINITE),
    "good.ply": (mesh("good.ply", FAR), "has a to_world that is not finite"),
}


def picture(scene: Scene) -> np.ndarray:
    traced = Tracer(scene).trace(scene.camera, frame_positions(scene.camera), 4, 1)
    return np.stack([np.array(channel) for channel in traced.radiance])


@pytest.mark.parametrize("name", PARTS)
def test_a_degenerate_mesh_is_named_and_left_out(name, tmp_path, caplog):
    content, wrong = PARTS[name]
    caplog.set_level("INFO", "hybrid")
    scene = loaded(tmp_path, content + mesh("flat.ply"))
    assert [message for message in caplog.messages if wrong in message and "left out" in message]
    # The one without area is harmless.
    assert scene.triangles == 1 + name.startswith("beside")
    image = picture(scene)
    assert np.isfinite(image).all()
    assert image.std() > 0.05


@extreme(
    "degenerate meshes in a scene",
    given="five meshes, without faces, with NaN and with infinity, beside a ball",
    expected="one line for each, and the ball",
)
def test_each_of_several_is_named(tmp_path, caplog, got):
    caplog.set_level("INFO", "hybrid")
    bad = ("none.ply", "points.ply", "nan.ply", "endless.ply", "nan.obj")
    scene = loaded(tmp_path, "".join(map(mesh, bad)) + mesh("good.ply"))
    assert got(sum("is left out" in message for message in caplog.messages)) == len(bad)
    assert scene.triangles == 1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (mesh("missing.ply"), "file not found"),
        (mesh("nan.ply") + '<shape type="strange"/>', "strange"),
        (mesh("nan.ply") + mesh("missing.ply"), "file not found"),
    ],
)
def test_what_else_is_wrong_is_refused(content, said, tmp_path):
    with pytest.raises(UserError, match=said) as caught:
        loaded(tmp_path, content)
    assert "\n" not in str(caught.value)


def test_faces_without_vertices_are_refused(tmp_path):
    with pytest.raises(UserError, match="a mesh has 3 vertices, and a face with number 7"):
        loaded(tmp_path, mesh("beyond.ply")).surfaces()
