"""Fingerprints, which decide whether forests and frames belong to a scene: their values must never change."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from pathtrace.scene.scene_xml import References, file_fingerprint, text_fingerprint

NAMING = '<scene><string name="{}" value="{}"/></scene>'


def of_file(folder, root: str) -> str:
    """Fingerprint of a file with the text <scene/>, whatever its elements."""
    file = folder / "scene.xml"
    file.write_text("<scene/>")
    elements = ET.fromstring(root)
    return file_fingerprint(file.read_bytes(), elements, References(file, elements))


def test_it_is_the_sha256_of_the_file_and_of_those_that_it_names(tmp_path):
    """The values are those of the program sha256sum, for <scene/> and <scene/>mesh."""
    assert of_file(tmp_path, "<scene/>").startswith("6683946bba5b83a4d39f2fe11cfd78e3")
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "box.ply").write_bytes(b"mesh")
    named = of_file(tmp_path, NAMING.format("filename", "meshes/box.ply"))
    assert named == "667f4152857fa7d19395ddb9c822f70bf67d9eb3049a5ec81b6c67f9c2d724d8"


def test_what_is_not_an_existing_file_is_skipped(tmp_path):
    (tmp_path / "box.ply").write_bytes(b"mesh")
    alone = of_file(tmp_path, "<scene/>")
    assert of_file(tmp_path, NAMING.format("filename", "missing.ply")) == alone
    assert of_file(tmp_path, NAMING.format("material", "box.ply")) == alone
    assert of_file(tmp_path, NAMING.format("filename", "")) == alone
    assert of_file(tmp_path, '<scene><string name="filename"/></scene>') == alone


def test_nested_elements_name_files_too(tmp_path):
    (tmp_path / "wood.png").write_bytes(b"mesh")
    nested = f"<scene><shape><bsdf>{NAMING.format('filename', 'wood.png')}</bsdf></shape></scene>"
    assert of_file(tmp_path, nested) == of_file(tmp_path, NAMING.format("filename", "wood.png"))
    assert of_file(tmp_path, nested) != of_file(tmp_path, "<scene/>")


def test_texts_are_told_apart_by_content():
    """The values are those of sha256sum."""
    assert text_fingerprint(repr({"type": "scene"})).startswith("69b9b69a57a9adcfd18f189a1baae136")
    assert text_fingerprint("abc at depth 3").startswith("7fe8440dce63784d94856a6e4a3030d4")
    assert len({text_fingerprint(f"{name} at depth {d}") for name in ("abc", "abd") for d in (3, 4)}) == 4
