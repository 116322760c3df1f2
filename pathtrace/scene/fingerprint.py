"""Fingerprints of scenes: SHA-256 hashes of everything that determines their light."""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any


def file_fingerprint(path: Path, root: ET.Element) -> str:
    """Hash of an XML file and of every file that it names, such as meshes and textures.

    Args:
        path: the XML file.
        root: its elements; a `<string name="filename">` names a file relative to the XML file's folder.
            Files that do not exist are skipped: Mitsuba reports them when it loads the scene.

    Returns:
        64 hexadecimal digits.
    """
    digest = hashlib.sha256(path.read_bytes())
    for element in root.iter("string"):
        file = path.parent / (element.get("value") or "")
        if element.get("name") == "filename" and file.is_file():
            digest.update(file.read_bytes())
    return digest.hexdigest()


def dictionary_fingerprint(description: dict[str, Any]) -> str:
    """Hash of a scene dictionary's printed form: 64 hexadecimal digits."""
    return hashlib.sha256(repr(description).encode()).hexdigest()


def fingerprint_at_depth(fingerprint: str, depth: int) -> str:
    """Hash of a scene whose path depth is not its own: images at another depth show other light."""
    return hashlib.sha256(f"{fingerprint} at depth {depth}".encode()).hexdigest()
