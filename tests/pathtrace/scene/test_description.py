"""The XML that Mitsuba gets, and the path depth that a scene asks for."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from compose.base.errors import UserError
from pathtrace.scene.scene_xml import SceneDescription, read_description

INTEGRATOR = '<integrator type="path"><integer name="max_depth" value="{}"/></integrator>'


def described(tmp_path, content: str) -> SceneDescription:
    file = tmp_path / "scene.xml"
    file.write_text(f'<scene version="3.0.0">{content}</scene>')
    return read_description(file)


@pytest.mark.parametrize(
    ("content", "depth"),
    [
        ("", -1),
        (INTEGRATOR.format(5), 5),
        (INTEGRATOR.format(" 5 "), 5),
        (INTEGRATOR.format(1), 1),
        # No limit, a large one, no number.
        (INTEGRATOR.format(-1), -1),
        (INTEGRATOR.format(0), -1),
        (INTEGRATOR.format(65), 65),
        pytest.param(INTEGRATOR.format("9" * 5000), -1, id="5,000 digits"),
        (INTEGRATOR.format("deep"), -1),
        ('<integrator type="path"><integer name="rr_depth" value="3"/></integrator>', -1),
        # Through a parameter, and in an integrator within another.
        ('<default name="bounces" value="4"/>' + INTEGRATOR.format("$bounces"), 4),
        # The first definition counts.
        ('<default name="b" value="4"/><default name="b" value="6"/>' + INTEGRATOR.format("$b"), 4),
        (INTEGRATOR.format("$bounces"), -1),
        (f'<integrator type="aov">{INTEGRATOR.format(6)}</integrator>', 6),
    ],
)
def test_the_scene_names_its_path_depth(tmp_path, content, depth):
    assert described(tmp_path, content).max_depth == depth


def test_an_included_integrator_counts_with_the_parameters_of_the_including_file(tmp_path):
    hides = '<integrator type="$i"><integer name="max_depth" value="$d"/>{}</integrator>'.format(
        '<boolean name="hide_emitters" value="$h"/>'
    )
    (tmp_path / "integrator.xml").write_text(f'<scene version="3.0.0">{hides}</scene>')
    defaults = "".join(
        f'<default name="{name}" value="{value}"/>'
        for name, value in {"i": "path", "d": 3, "h": "true"}.items()
    )
    found = described(tmp_path, defaults + '<include filename="integrator.xml"/>')
    assert (found.max_depth, found.hides_emitters) == (3, True)


def test_only_the_integrator_is_removed(tmp_path):
    content = (
        '<default name="integrator" value="only_its_author_has_it"/><default name="spp" value="4"/>'
        '<integrator type="$integrator"/><sensor type="perspective"/><shape type="sphere"/>'
    )
    root = ET.fromstring(described(tmp_path, content).text)
    assert root.tag == "scene"
    assert root.get("version") == "3.0.0"
    # Included files may refer to its name.
    assert [(child.tag, child.get("name")) for child in root] == [
        ("default", "integrator"),
        ("default", "spp"),
        ("sensor", None),
        ("shape", None),
    ]


def test_the_fingerprint_covers_named_files(tmp_path):
    content = '<shape type="ply"><string name="filename" value="box.ply"/></shape>'
    (tmp_path / "box.ply").write_text("one")
    first = described(tmp_path, content).fingerprint
    assert described(tmp_path, content).fingerprint == first
    (tmp_path / "box.ply").write_text("other")
    assert described(tmp_path, content).fingerprint != first


def test_text_that_is_not_xml_is_refused(tmp_path):
    file = tmp_path / "broken.xml"
    file.write_text("<scene version='3.0.0'><shape")
    with pytest.raises(UserError, match=r"broken\.xml: not well-formed XML"):
        read_description(file)


def test_an_integrator_that_is_kept_must_be_mitsubas_own(tmp_path):
    file = tmp_path / "scene.xml"
    file.write_text('<scene version="3.0.0"><integrator type="own"/></scene>')
    assert "own" in read_description(file, with_integrator=True).text
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins/own.so").touch()
    assert "own" not in read_description(file).text
    with pytest.raises(UserError, match="may not bring its own code"):
        read_description(file, with_integrator=True)
