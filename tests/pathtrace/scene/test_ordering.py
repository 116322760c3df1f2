"""The same scene has the same order of shapes, and with it the same noise, each time it is loaded."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.scene.scene import load_scene, with_ordered_shapes
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
SCENE = """
<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="60"/>
    <transform name="to_world"><lookat origin="0, 0, -6" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
  {shapes}
</scene>
"""
SHAPE = """<shape type="{kind}">{light}
  <bsdf type="diffuse"><rgb name="reflectance" value="0.5, {green}, 0.5"/></bsdf>
  <transform name="to_world"><scale value="0.3"/><translate x="{x}" y="{y}"/></transform></shape>"""
LIGHT = '<emitter type="area"><rgb name="radiance" value="{power}"/></emitter>'


@pytest.fixture(scope="module")
def many() -> str:
    """Shapes with the same material, which Mitsuba merges, and lights among them."""
    rng = small.rng(1)
    shapes = [
        SHAPE.format(
            kind=("rectangle", "cube")[number % 2],
            light=LIGHT.format(power=f"{1 + number}, 1, 1") if number % 3 == 0 else "",
            green=("0.2", "0.7")[number % 4 // 2],
            x=rng.uniform(-2, 2),
            y=rng.uniform(-2, 2),
        )
        for number in range(40)
    ]
    return SCENE.format(shapes="".join(shapes))


def boxes(scene) -> list[tuple[float, ...]]:
    """Corners of the shapes' bounding boxes, in the scene's order."""
    return [
        (*np.ravel(shape.bbox().min).tolist(), *np.ravel(shape.bbox().max).tolist())
        for shape in scene.shapes()
    ]


def test_merged_shapes_come_in_the_same_order_each_time(many):
    loaded = [mi.load_string(many) for _ in range(4)]
    ordered = [boxes(with_ordered_shapes(scene)[0]) for scene in loaded]
    assert all(order == ordered[0] for order in ordered)
    assert sorted(boxes(loaded[0])) == ordered[0]
    assert len(set(ordered[0])) > 10


def test_the_same_seed_gives_the_same_noise_each_time(many, tmp_path):
    file = tmp_path / "many.xml"
    file.write_text(many)

    def noise() -> np.ndarray:
        scene = load_scene(file)
        camera = scene.camera.resized(24, 16)
        return interleaved(Tracer(scene).trace(camera, frame_positions(camera), 2, 3).radiance)

    first = noise()
    for _ in range(3):
        np.testing.assert_array_equal(noise(), first)


def test_shapes_with_equal_boxes_are_told_apart_by_their_primitives():
    """A ball is one primitive, its cube twelve."""
    ball, cube = {"type": "sphere"}, {"type": "cube"}
    for shapes in ((ball, cube), (cube, ball)):
        scene = mi.load_dict({"type": "scene", "a": shapes[0], "b": shapes[1]}, optimize=False)
        assert [shape.primitive_count() for shape in with_ordered_shapes(scene)[0].shapes()] == [1, 12]


def test_cameras_and_lights_of_all_kinds_are_kept():
    description = small.corner()
    description["sky"] = {"type": "constant", "radiance": 0.5}
    description["bulb"] = {"type": "point", "position": [0, 1, 0]}
    description["other"] = small.sensor(8, 8)
    scene = mi.load_dict(description)
    ordered, _ = with_ordered_shapes(scene)
    assert len(ordered.shapes()) == 4
    assert len(ordered.emitters()) == len(scene.emitters()) == 3
    assert ordered.environment() is not None
    sizes = [tuple(sensor.film().size()) for sensor in ordered.sensors()]
    assert sizes == [tuple(sensor.film().size()) for sensor in scene.sensors()]
    assert len(sizes) == 2
