"""Scenes: what loads, and what is refused."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from compose.base.errors import UserError
from pathtrace.scene.scene import load_scene
from pathtrace.scene.scene_xml import DEFAULT_MAX_DEPTH
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


def test_a_bundled_scene_loads():
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
    assert scene.camera.width == 768


def test_a_file_named_scene_is_called_by_its_folder(tmp_path):
    (tmp_path / "attic").mkdir()
    file = tmp_path / "attic" / "scene.xml"
    file.write_text(MINIMAL.format(sensor=SENSOR, emitter=EMITTER))
    assert load_scene(file).name == load_scene(tmp_path / "attic").name == "attic"


def test_triangles_are_those_of_meshes(tmp_path):
    """A cube has twelve, a sphere none."""
    file = tmp_path / "mine.xml"
    text = MINIMAL.format(sensor=SENSOR, emitter=EMITTER)
    file.write_text(text)
    assert load_scene(file).triangles == 0
    file.write_text(text.replace("</scene>", "<shape type='cube'/></scene>"))
    assert load_scene(file).triangles == 12


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
        ("<shape version='3.0.0' type='sphere'/>", "complete scene"),
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
    scene = load_scene(small.furnace())
    assert (scene.name, scene.max_depth, scene.camera.width) == ("dictionary", DEFAULT_MAX_DEPTH, 32)
    assert len(scene.mitsuba.shapes()) == 1


@pytest.mark.parametrize("name", ["staircase2", "veach-bidir"])
def test_scenes_in_the_wild_load(name):
    scene = load_scene(real_file(f"scenes/{name}/scene.xml"))
    assert scene.name == name
    assert scene.triangles > 10_000


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores of a process are set on Linux")
def test_a_single_core_loads_every_bundled_scene():
    """Mitsuba waits for threads that are not there, unless Dr.Jit is given some."""
    script = f"""
import os
os.sched_setaffinity(0, [{min(os.sched_getaffinity(0))}])
from pathtrace.scene.backend import select_backend
from pathtrace.scene.scene import bundled_scenes
from pathtrace.scene.scene import load_scene
select_backend()
print(*(load_scene(name).name for name in bundled_scenes()))
"""
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "room" in done.stdout.split()
