"""What Mitsuba loads, and how its refusals are reported."""

from __future__ import annotations

import mitsuba as mi
import pytest

from compose.base.errors import UserError
from pathtrace.scene.loading import Source, load_mitsuba

pytestmark = pytest.mark.usefixtures("backend")
MESH = """<scene version="3.0.0">
  <shape type="obj"><string name="filename" value="triangle.obj"/></shape>
</scene>"""
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def search_path() -> list[str]:
    resolver = mi.file_resolver()
    return [str(resolver[i]) for i in range(len(resolver))]


def test_files_are_relative_to_the_scenes_folder(tmp_path):
    """And to that of this scene only: the next one has another file of the same name."""
    before = search_path()
    for folder, faces in (("one", 1), ("two", 2)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "triangle.obj").write_text(TRIANGLE + "f 1 3 2\n" * (faces - 1))
        scene = load_mitsuba(Source("scene", MESH, tmp_path / folder))
        assert scene.shapes()[0].face_count() == faces
        assert search_path() == before


def test_the_search_path_is_restored_after_a_refusal(tmp_path):
    before = search_path()
    with pytest.raises(UserError):
        load_mitsuba(Source("scene", MESH, tmp_path))
    assert search_path() == before


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("<scene version='3.0.0'><shape type='nonsense'/></scene>", "Mitsuba refuses the scene: .*nonsense"),
        ("<shape version='3.0.0' type='sphere'/>", "not a complete scene"),
    ],
)
def test_a_refusal_is_one_line_that_names_the_file(tmp_path, text, complaint):
    with pytest.raises(UserError, match=complaint) as caught:
        load_mitsuba(Source(str(tmp_path / "bad.xml"), text, tmp_path))
    assert str(caught.value).startswith(f"{tmp_path / 'bad.xml'}: ")
    assert "\n" not in str(caught.value)


def test_dictionaries_load_and_are_refused_alike():
    assert len(load_mitsuba(Source("mine", {"type": "scene", "s": {"type": "sphere"}})).shapes()) == 1
    for description in ({"type": "sphere"}, {"type": "scene", "s": {"type": "nonsense"}}):
        with pytest.raises(UserError, match=r"^mine: [^\n]*$"):
            load_mitsuba(Source("mine", description))
