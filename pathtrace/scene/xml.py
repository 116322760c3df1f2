"""Parses a scene's XML: nothing in it makes the parser, or Mitsuba's, take unbounded memory or stack."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from compose.base.errors import UserError, one_line
from compose.base.files import require_size_below

# Scenes with thousands of shapes have some megabytes of XML, nested ten deep.
_MOST_BYTES = 1 << 28
_DEEPEST = 100


def parse_xml(path: Path) -> ET.Element:
    """The top element of an XML file.

    Raises:
        UserError: the file cannot be read, is too large, is not well-formed, declares entities, which can
            stand for any amount of text, or is nested too deeply for parsers that call themselves.
    """
    try:
        require_size_below(path, _MOST_BYTES)
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read ({one_line(error)})") from error
    # In UTF-16, each character has a zero byte.
    if b"<!ENTITY" in content.replace(b"\0", b""):
        raise UserError(f"{path}: declares XML entities; write out what they stand for")
    try:
        root = ET.fromstring(content)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise UserError(f"{path}: not well-formed XML: {one_line(error)}") from error
    _check_depth(path, root)
    return root


def _check_depth(path: Path, root: ET.Element) -> None:
    level, depth = [root], 1
    while level:
        if depth > _DEEPEST:
            raise UserError(f"{path}: elements are nested more than {_DEEPEST} deep")
        level, depth = [child for element in level for child in element], depth + 1
