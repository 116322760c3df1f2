"""Scenes: what loads, what is refused and how."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.scene.bundled import bundled_scenes
from pathtrace.scene.scene import DEFAULT_MAX_DEPTH, load_scene
from tests import small
from tests.conftest import real_file

pytestmark = pytest.mark.usefixtures("backend")

MINIMAL = """<scene version="3.0.0">
  <default name="integrator" value="an_integrator_only_its_author_has"/>
  <default name="max_depth" value="5"/>
  <integrator type="$integrator"><integer name="max_depth" value="$max_depth"/></integrator>
  {sensor}
  <shape type="sphere">{emitter}</shape>
</scene>"""
SENSOR = '<sensor type="perspective"><film type="hdrfilm"/></sensor>'
EMITTER = '<emitter type="area"/>'


def test_the_bundled_scenes_load():
    assert {"cornell", "room"} <= set(bundled_scenes())
    room = load_scene("room")
    assert 20_500 <= room.triangles <= 21_500
    assert len(room.mitsuba.emitters()) == 2
    assert room.name == "room"


def test_an_unknown_integrator_does_not_matter(tmp_path):
    file = tmp_path / "mine.xml"
    file.write_text(MINIMAL.format(sensor=SENSOR, emitter=EMITTER))
    scene = load_scene(file)
    assert (scene.name, scene.max_depth) == ("mine", 5)
    assert load_scene(file, max_depth=3).max_depth == 3


def test_the_hash_follows_the_content(tmp_path):
    file = tmp_path / "mine.xml"
    file.write_text(MINIMAL.format(sensor=SENSOR, emitter=EMITTER))
    first = load_scene(file).hash
    assert load_scene(file).hash == first
    file.write_text(file.read_text().replace("sphere", "cube"))
    assert load_scene(file).hash != first


def test_the_hash_follows_a_depth_that_is_not_the_scenes_own(tmp_path):
    file = tmp_path / "mine.xml"
    file.write_text(MINIMAL.format(sensor=SENSOR, emitter=EMITTER))
    own, three, four = (load_scene(file, max_depth=depth).hash for depth in (None, 3, 4))
    assert len({own, three, four}) == 3
    assert load_scene(file, max_depth=5).hash == own
    assert load_scene(file, max_depth=3).hash == three
    furnace = load_scene(small.furnace()).hash
    assert load_scene(small.furnace(), max_depth=DEFAULT_MAX_DEPTH).hash == furnace
    assert load_scene(small.furnace(), max_depth=40).hash != furnace


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (MINIMAL.format(sensor="", emitter=EMITTER), "no camera"),
        (MINIMAL.format(sensor=SENSOR, emitter=""), "no light"),
        (
            MINIMAL.format(sensor=SENSOR.replace("perspective", "orthographic"), emitter=EMITTER),
            "perspective",
        ),
        ("<scene version='3.0.0'><shape type='nonsense'/></scene>", "Mitsuba refuses"),
        ("<scene version='3.0.0'><shape", "not well-formed"),
        ("<shape version='3.0.0' type='sphere'/>", "whole scene"),
    ],
)
def test_a_bad_scene_is_refused_in_one_line(tmp_path, text, complaint):
    file = tmp_path / "bad.xml"
    file.write_text(text)
    with pytest.raises(UserError, match=complaint) as caught:
        load_scene(file)
    assert "bad.xml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_scene_is_refused():
    with pytest.raises(UserError, match=r"nowhere\.xml: no such scene"):
        load_scene("nowhere.xml")


def test_a_dictionary_is_a_scene():
    assert load_scene(small.furnace()).camera.width == 32


@pytest.mark.parametrize("name", ["staircase2", "veach-bidir"])
def test_scenes_in_the_wild_load(name):
    scene = load_scene(real_file(f"scenes/{name}/scene.xml"))
    assert scene.name == name
    assert scene.triangles > 10_000


# Shapes with the same material, which Mitsuba merges, and lights among them.
_MANY = """
<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="60"/>
    <transform name="to_world"><lookat origin="0, 0, -6" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
  {shapes}
</scene>
"""
_SHAPE = """<shape type="{kind}">{light}
  <bsdf type="diffuse"><rgb name="reflectance" value="0.5, {green}, 0.5"/></bsdf>
  <transform name="to_world"><scale value="0.3"/><translate x="{x}" y="{y}"/></transform></shape>"""
_LIGHT = '<emitter type="area"><rgb name="radiance" value="{power}"/></emitter>'
_TRACES = """
import compose, hashlib, sys
from hybrid.options import loaded_scene, select
select("auto")
from pathtrace.film import frame_positions, interleaved
from pathtrace.tracer import Tracer
scene = loaded_scene(sys.argv[1])
camera = scene.camera.resized(24, 16)
radiance = interleaved(Tracer(scene).trace(camera, frame_positions(camera), 2, 3).radiance)
print(hashlib.sha256(radiance.tobytes()).hexdigest())
"""


def test_the_same_seed_gives_the_same_noise_in_another_process(tmp_path):
    rng = np.random.default_rng(1)
    shapes = [
        _SHAPE.format(
            kind=("rectangle", "cube")[number % 2],
            light=_LIGHT.format(power=f"{1 + number}, 1, 1") if number % 3 == 0 else "",
            green=("0.2", "0.7")[number % 4 // 2],
            x=rng.uniform(-2, 2),
            y=rng.uniform(-2, 2),
        )
        for number in range(40)
    ]
    file = tmp_path / "many.xml"
    file.write_text(_MANY.format(shapes="".join(shapes)))
    found = {
        subprocess.run(
            [sys.executable, "-c", _TRACES, file], capture_output=True, text=True, check=True
        ).stdout
        for _ in range(3)
    }
    assert len(found) == 1
