"""Prepares a scene's XML file for Mitsuba."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

from pathtrace.scene.fingerprint import file_fingerprint
from pathtrace.scene.plugins import require_own_plugins
from pathtrace.scene.references import References
from pathtrace.scene.sunsky import balance_xml
from pathtrace.scene.xml import parse_xml

# Beyond this path depth, hardly any energy is left in a closed room.
DEFAULT_MAX_DEPTH = 8


@dataclass(frozen=True)
class SceneDescription:
    """A scene's XML without its integrator.

    Attributes:
        text: XML for Mitsuba.
        fingerprint: hash of the file and of all files that it names.
        max_depth: path depth that the scene asks for, DEFAULT_MAX_DEPTH at most.
    """

    text: str
    fingerprint: str
    max_depth: int


def read_description(path: Path) -> SceneDescription:
    """Reads a scene's XML file and removes its integrator.

    Radiance always comes from Mitsuba's `path`; scenes found elsewhere may name integrators that only their
    author has, which Mitsuba would refuse.

    Raises:
        UserError: the file is not well-formed XML, might take unbounded memory, or would load native code
            that is not Mitsuba's.
    """
    root = parse_xml(path)
    depth = _max_depth(root)
    for integrator in root.findall("integrator"):
        root.remove(integrator)
    for default in root.findall("default"):
        if default.get("name") == "integrator":
            root.remove(default)
    references = References.of(path, root)
    require_own_plugins(path, references.plugins, [path.parent, *references.folders])
    fingerprint = file_fingerprint(path, root, references)
    balance_xml(root)
    return SceneDescription(ET.tostring(root, encoding="unicode"), fingerprint, depth)


def _max_depth(root: ET.Element) -> int:
    """Path depth of the scene's integrator, with `$` parameters replaced by their defaults."""
    defaults = {element.get("name"): element.get("value") for element in root.iter("default")}
    depth = DEFAULT_MAX_DEPTH
    for integrator in root.findall("integrator"):
        values = (e.get("value") for e in integrator.iter("integer") if e.get("name") == "max_depth")
        value = next(values, None)
        if value and value.startswith("$"):
            value = defaults.get(value[1:])
        # Longer numbers are beyond the limit as well.
        if value and re.fullmatch(r"-?\d{1,9}", value.strip()):
            # -1 is Mitsuba's "no limit".
            depth = min(int(value), DEFAULT_MAX_DEPTH) if int(value) > 0 else DEFAULT_MAX_DEPTH
    return depth
