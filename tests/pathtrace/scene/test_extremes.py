"""Scenes of any size and place: what Mitsuba traces of them, and which ones are refused."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.camera import camera_from_pose
from compose.camera.coordinate_systems import WORLD, opencv_from_mitsuba
from pathtrace.scene.scene import Scene, bundled_scenes, load_scene
from tests import small
from tests.extremes import extreme
from tests.placed import placed

pytestmark = pytest.mark.usefixtures("backend")


def lamp() -> dict:
    """The corner with a point light instead of its lamp."""
    light = {"type": "point", "position": [0.2, 0.8, 0.0], "intensity": {"type": "rgb", "value": 8.0}}
    return {**small.corner(), "lamp": light}


SCENES = {"corner": small.corner, "lamp": lamp}


def picture(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Radiance (N, 3) of a few paths a pixel, by Mitsuba alone, and distances (24 * 24,) in world space."""
    sensor = scene.mitsuba.sensors()[0]
    path = mi.load_dict({"type": "path", "max_depth": 4})
    image = np.array(mi.render(scene.mitsuba, sensor=sensor, integrator=path, spp=16, seed=1))
    return image, scene.surfaces().probe(scene.camera) * scene.place.unit


@cache
def ordinary(kind: str) -> tuple[np.ndarray, np.ndarray]:
    return picture(load_scene(SCENES[kind]()))


@pytest.mark.parametrize(
    ("kind", "scale", "offset"),
    [
        pytest.param(
            *values,
            marks=extreme(f"path tracing {name}", given=given, expected="over 60 dB at equal seeds"),
        )
        for name, given, *values in [
            ("at a scale of 1e-4", "a corner of a room scaled by 1e-4", "corner", 1e-4, 0.0),
            ("at a scale of 1e-9", "a corner of a room scaled by 1e-9", "corner", 1e-9, 0.0),
            ("at a scale of 1e6", "a corner of a room scaled by 1e6", "corner", 1e6, 0.0),
            ("1e3 from the origin", "a corner of a room moved by 1e3", "corner", 1.0, 1e3),
            ("1e6 from the origin", "a corner of a room moved by 1e6", "corner", 1.0, 1e6),
            ("small and far", "scaled by 1e-3 and moved by 1e3", "corner", 1e-3, 1e3),
            ("of a tiny point light", "lit by a point, scaled by 1e-4", "lamp", 1e-4, 0.0),
            ("of a distant point light", "lit by a point, moved by 1e6", "lamp", 1.0, 1e6),
        ]
    ],
)
def test_a_scene_of_any_size_and_place_looks_the_same(kind, scale, offset, got):
    image, distance = picture(load_scene(placed(SCENES[kind](), scale, offset)))
    expected, before = ordinary(kind)
    assert expected.mean() > 0.05
    difference = np.mean((np.clip(image, 0, 1) - np.clip(expected, 0, 1)) ** 2)
    assert got(-10 * np.log10(max(difference, 1e-12)), ".0f") > 60
    # Digits of the coordinates that were given: float64 holds 1e-16 of them.
    assert got(float(np.abs(distance / scale / before - 1).max()), ".1e") < 1e-5


def test_cameras_of_the_world_come_to_the_scenes_coordinates():
    """The camera that the file names, in float64, is the scene's own in the scene's coordinates."""
    description = placed(small.corner(), 1e-4, 1e3)
    scene = load_scene(description)
    to_world = np.array(description["sensor"]["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    own = scene.camera
    size = own.width, own.height, own.fx, own.fy, own.cx, own.cy
    found = scene.place.camera(camera_from_pose(opencv_from_mitsuba(to_world), *size))
    np.testing.assert_allclose(found.camera_to_world, own.camera_to_world, atol=1e-6)
    np.testing.assert_allclose(scene.place.in_world(own.position[None])[0], to_world[:3, 3], rtol=1e-15)


def test_ordinary_scenes_keep_the_coordinates_of_their_files():
    for name in bundled_scenes():
        assert load_scene(name).place == WORLD
    for scale in (0.1, 1.0, 10.0, 1e4):
        assert load_scene(placed(small.corner(), scale)).place == WORLD


_VERTICES = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
_FACES = (142, 134, 568, 587, 126, 165, 384, 378, 157, 173, 248, 286)


def xml(folder: Path, at: float, vertices: float = 0.0, more: str = "") -> Path:
    """A cube from a file and an instance of a ball before a wall, lit by a point and the sky, at x = `at`."""
    rows = [f"v {x + vertices} {y} {z}" for x, y, z in _VERTICES]
    rows += [f"f {' '.join(str(face))}" for face in _FACES]
    (folder / "cube.obj").write_text("\n".join(rows) + "\n")
    (folder / "scene.xml").write_text(f"""<scene version="3.0.0">
<default name="at" value="{at}"/>
<sensor type="perspective">
 <float name="fov" value="50"/>
 <transform name="to_world">
  <lookat origin="0.5,0.4,-4" target="0.5,0.5,0" up="0,1,0"/><translate x="$at"/>
 </transform>
 <film type="hdrfilm">
  <integer name="width" value="32"/><integer name="height" value="32"/><rfilter type="box"/>
 </film>
</sensor>
<shape type="obj">
 <string name="filename" value="cube.obj"/>
 <transform name="to_world"><translate x="{at - vertices}"/></transform>
</shape>
<shape type="rectangle">
 <transform name="to_world"><scale value="5"/><translate z="2"/><translate x="$at"/></transform>
 <bsdf type="twosided"><bsdf type="diffuse"/></bsdf>
</shape>
<emitter type="point">
 <point name="position" x="{at - 1}" y="2" z="-3"/><rgb name="intensity" value="9"/>
</emitter>
<emitter type="constant"><rgb name="radiance" value="0.2"/></emitter>
<shape type="shapegroup" id="group"><shape type="sphere"><float name="radius" value="0.4"/></shape></shape>
<shape type="instance">
 <ref id="group"/><transform name="to_world"><translate x="-0.6"/><translate x="$at"/></transform>
</shape>
{more}</scene>""")
    return folder / "scene.xml"


@extreme(
    "a scene file 1e6 from the origin",
    given="mesh file, instance, point light and camera moved by to_world and position",
    expected="over 60 dB to the unmoved one at equal seeds",
)
def test_files_are_moved_as_well(tmp_path, got):
    images = []
    for at in (0.0, 1e6):
        folder = tmp_path / str(at)
        folder.mkdir()
        images.append(picture(load_scene(xml(folder, at)))[0])
    difference = float(np.mean((images[0] - images[1]) ** 2))
    assert images[0].mean() > 0.1
    assert got(-10 * np.log10(max(difference, 1e-12)), ".0f") > 60


@extreme(
    "mesh vertices 1e6 from the origin",
    given="a cube of 1 with vertices at 1e6 in its file",
    expected="refused in one line",
)
def test_vertices_that_float32_cannot_hold_are_refused(tmp_path, got):
    with pytest.raises(UserError, match=r"meshes have vertices 1e\+06 from the origin") as caught:
        load_scene(xml(tmp_path, 1e6, vertices=1e6))
    assert "\n" not in str(caught.value).replace(str(tmp_path), "")
    got(str(caught.value).split(": ", 1)[1])


@pytest.mark.parametrize(
    "more",
    [
        pytest.param(
            m,
            marks=extreme(
                f"distant {n}", given="a scene 1e6 from the origin", expected="refused in one line"
            ),
        )
        for n, m in {
            "projector": "<emitter type='projector'><rgb name='irradiance' value='1'/></emitter>",
            "medium": "<medium type='homogeneous' id='fog'/>",
        }.items()
    ],
)
def test_parts_that_cannot_be_moved_are_refused(more, tmp_path, got):
    with pytest.raises(UserError, match="too far from the origin for Mitsuba's float32, and a ") as caught:
        load_scene(xml(tmp_path, 1e6, more=more))
    got(str(caught.value).split(": ", 1)[1])


@extreme("a mirrored camera", given="to_world with a scale of -1 along x", expected="refused in one line")
def test_a_mirrored_sensor_is_refused(got):
    description = small.corner()
    description["sensor"]["to_world"] = description["sensor"]["to_world"] @ mi.ScalarTransform4f().scale(
        [-1, 1, 1]
    )
    with pytest.raises(UserError, match="the camera's to_world: pose is not rigid: it mirrors") as caught:
        load_scene(description)
    assert "\n" not in got(str(caught.value))


@extreme("a camera amid nothing, far away", given="only a sky, camera at 1e6", expected="loads")
def test_a_sky_alone_loads_anywhere(got):
    scene = load_scene(
        placed({"type": "scene", "sensor": small.sensor(), "sky": {"type": "constant"}}, 1.0, 1e6)
    )
    assert got(scene.surfaces().median_distance(scene.camera)) == np.inf
