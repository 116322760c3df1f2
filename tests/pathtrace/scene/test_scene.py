"""Scenes: what loads, and what is refused."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import mitsuba as mi
import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.scene import scene as scene_module
from pathtrace.scene.optics import Optics
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


def test_one_thread_loads_every_bundled_scene():
    """Mitsuba waits for threads that are not there, unless Dr.Jit is given some meanwhile."""
    script = """
from pathtrace.scene.backend import select_backend
from pathtrace.scene.scene import bundled_scenes, load_scene
import drjit
drjit.set_thread_count(1)
select_backend()
print(*(load_scene(name).name for name in bundled_scenes()), drjit.thread_count())
"""
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    *names, threads = done.stdout.split()
    assert "room" in names
    assert threads == "1"


@pytest.mark.parametrize(
    ("folder", "name"), [(".hidden", "hidden"), ("a\u00a0b", "a_b"), ("...", "scene"), ("b" * 250, "b" * 200)]
)
def test_a_folder_of_any_name_gives_a_name(tmp_path, folder, name):
    (tmp_path / folder).mkdir()
    (tmp_path / folder / "scene.xml").write_text(MINIMAL.format(sensor=SENSOR, emitter=EMITTER))
    assert load_scene(tmp_path / folder).name == name


def test_a_scene_of_an_old_mitsuba_is_named_with_what_is_wrong(tmp_path):
    file = tmp_path / "old.xml"
    shape = (
        '<shape type="sphere"><bsdf type="conductor"><float name="ext_eta" value="1"/></bsdf></shape></scene>'
    )
    text = MINIMAL.format(sensor=SENSOR, emitter=EMITTER).replace("</scene>", shape)
    file.write_text(text.replace('version="3.0.0"', 'version="0.6.0"'))
    with pytest.raises(
        UserError, match=r"conductor.*ext_eta.* \(a scene of Mitsuba 0\.6\.0: `mitsuba -u FILE`"
    ):
        load_scene(file)


def test_a_link_finds_its_files_beside_it(tmp_path):
    """As hubs keep what was downloaded: links to files in a store."""
    (tmp_path / "store").mkdir()
    (tmp_path / "snapshot").mkdir()
    shape = '<shape type="obj"><string name="filename" value="m.obj"/></shape></scene>'
    content = MINIMAL.format(sensor=SENSOR, emitter=EMITTER).replace("</scene>", shape)
    (tmp_path / "store" / "1").write_text(content)
    (tmp_path / "store" / "2").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for name, blob in (("scene.xml", "1"), ("m.obj", "2")):
        (tmp_path / "snapshot" / name).symlink_to(tmp_path / "store" / blob)
    loaded = load_scene(tmp_path / "snapshot")
    assert (loaded.name, loaded.triangles) == ("snapshot", 1)


def test_xml_text_is_a_scene_whose_files_lie_in_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    shape = '<shape type="obj"><string name="filename" value="m.obj"/></shape></scene>'
    text = "\n" + MINIMAL.format(sensor=SENSOR, emitter=EMITTER).replace("</scene>", shape)
    loaded = load_scene(text)
    assert (loaded.name, loaded.triangles, loaded.max_depth) == ("text", 1, 5)
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\n")
    assert load_scene(text).hash != loaded.hash
    with pytest.raises(UserError, match="not well-formed XML"):
        load_scene("<scene")


def test_the_hash_of_a_dictionary_follows_what_it_holds(tmp_path):
    file = tmp_path / "m.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")

    def digest(red: float) -> str:
        image = mi.Bitmap(np.full((4, 4, 3), [red, 0, 0], np.float32))
        paint = {"type": "diffuse", "reflectance": {"type": "bitmap", "bitmap": image, "raw": True}}
        mesh = {"type": "obj", "filename": str(file), "bsdf": paint}
        return load_scene({**small.furnace(), "mesh": mesh}).hash

    first = digest(0.2)
    assert digest(0.2) == first
    assert digest(0.3) != first
    file.write_text("v 0 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\n")
    assert digest(0.2) != first


def test_threads_load_their_own_scenes(tmp_path):
    """Each looks for a mesh of the same name in its own folder."""
    shape = '<shape type="obj"><string name="filename" value="m.obj"/></shape></scene>'
    for count in (1, 2):
        folder = tmp_path / str(count)
        folder.mkdir()
        text = MINIMAL.format(sensor=SENSOR, emitter=EMITTER).replace("</scene>", shape)
        (folder / "scene.xml").write_text(text)
        (folder / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n" + count * "f 1 2 3\n")
    with ThreadPoolExecutor(4) as pool:
        loaded = pool.map(lambda count: load_scene(tmp_path / str(count)).triangles, [1, 2] * 8)
    assert list(loaded) == [1, 2] * 8


LEFT_OUT = {
    "2 cameras; sensor, the first perspective one": lambda: {"plan": {"type": "orthographic"}},
    "depth of field is left out": lambda: {
        "sensor": {**small.sensor(), "type": "thinlens", "aperture_radius": 0.1}
    },
    "participating media are left out": lambda: {
        "glass": {
            "type": "sphere",
            "radius": 0.1,
            "interior": {"type": "homogeneous", "sigma_t": 0.1},
            "bsdf": {"type": "dielectric"},
        }
    },
}


@pytest.mark.parametrize("said", LEFT_OUT)
def test_what_mitsuba_would_show_otherwise_is_said_once(said, caplog):
    scene_module._say.cache_clear()
    with caplog.at_level("INFO", logger="hybrid"):
        for _ in range(2):
            load_scene({**small.furnace(), **LEFT_OUT[said]()})
    assert [said in record.getMessage() for record in caplog.records] == [True]


def test_hidden_lights_and_media_change_the_hash(tmp_path):
    plain = load_scene(small.furnace())
    assert plain.optics == Optics()
    smoke = {"type": "sphere", "interior": {"type": "homogeneous"}, "bsdf": {"type": "null"}}
    hidden = {"type": "path", "hide_emitters": True}
    found = [load_scene({**small.furnace(), **more}) for more in ({"smoke": smoke}, {"path": hidden})]
    assert [scene.optics for scene in found] == [Optics(has_media=True), Optics(hides_emitters=True)]
    assert len({scene.hash for scene in (plain, *found)}) == 3


def test_hidden_lights_of_a_file_are_hidden(tmp_path):
    flag = '<integrator type="path"><boolean name="hide_emitters" value="true"/></integrator></scene>'
    file = tmp_path / "hidden.xml"
    file.write_text(MINIMAL.format(sensor=SENSOR, emitter=EMITTER).replace("</scene>", flag))
    assert load_scene(file).optics.hides_emitters


@pytest.mark.parametrize(("asked", "depth"), [(3, 3), (-1, 8), (65, 8)])
def test_paths_are_no_longer_than_asked_nor_than_what_carries_light(asked, depth):
    integrator = {"type": "path", "max_depth": asked}
    assert load_scene({**small.furnace(), "integrator": integrator}).max_depth == depth


def test_a_camera_is_chosen_by_its_id():
    other = small.sensor(40, 20)
    description = {**small.furnace(), "zoom": other}
    first, chosen = load_scene(description), load_scene(description, sensor="zoom")
    assert (first.camera.width, chosen.camera.width) == (32, 40)
    assert first.hash != chosen.hash == load_scene(description, sensor="zoom").hash
    assert load_scene(description, sensor="sensor").hash == first.hash
    with pytest.raises(UserError, match="sensor third: the scene's perspective cameras are sensor, zoom"):
        load_scene(description, sensor="third")


CLIPS = [({}, None), ({"near_clip": 0.5}, None), ({"near_clip": 3.5}, 3.5), ({"far_clip": 2.0}, 0.01)]


@pytest.mark.parametrize(("clips", "near"), CLIPS)
def test_clipping_planes_count_where_they_cut_something_off(clips, near):
    scene = load_scene({**small.furnace(), "sensor": {**small.sensor(), **clips}})
    found = None if scene.optics.clips is None else scene.optics.clips[0]
    assert found == (None if near is None else pytest.approx(near))
