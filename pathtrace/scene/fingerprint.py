"""Fingerprints of scenes: SHA-256 hashes of everything that determines their light."""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from compose.base.errors import UserError, one_line
from compose.base.files import require_size_below
from pathtrace.scene.references import References, is_file

_MOST_BYTES = 1 << 36


def file_fingerprint(path: Path, root: ET.Element, references: References | None = None) -> str:
    """Hash of an XML file and of every file that Mitsuba loads because of it.

    Scenes that name all their files directly, relative to their folder, have the same hash as ever. Files
    that only includes, search folders or parameters lead to are added, with their sizes.

    Args:
        path: the XML file.
        root: its elements.
        references: what they refer to, if it is known already. Files that do not exist are skipped: Mitsuba
            reports them when it loads the scene.

    Returns:
        64 hexadecimal digits.

    Raises:
        UserError: an included file is damaged, or a file cannot be read.
    """
    digest = hashlib.sha256(path.read_bytes())
    direct = [
        path.parent / (element.get("value") or "")
        for element in root.iter("string")
        if element.get("name") == "filename"
    ]
    direct = [file for file in direct if is_file(file)]
    for file in direct:
        _add(digest, file)
    references = references or References.of(path, root)
    for number, name in enumerate(references.names):
        for file in references.candidates(name):
            if file not in direct:
                digest.update(f"{number} {file.stat().st_size}\0".encode())
                _add(digest, file)
    return digest.hexdigest()


def _add(digest: hashlib._Hash, file: Path) -> None:
    """Adds the content of a file, block by block."""
    try:
        left = require_size_below(file, _MOST_BYTES)
        with file.open("rb") as opened:
            # No more than its size: some files of the system never end.
            while left > 0 and (block := opened.read(min(left, 1 << 20))):
                digest.update(block)
                left -= len(block)
    except (OSError, ValueError) as error:
        raise UserError(f"{file}: cannot be read ({one_line(error)})") from error


def dictionary_fingerprint(description: dict[str, Any]) -> str:
    """Hash of a scene dictionary's printed form: 64 hexadecimal digits."""
    return hashlib.sha256(repr(description).encode()).hexdigest()


def fingerprint_with_thin_glass(fingerprint: str) -> str:
    """Hash of a scene whose panes let shadow rays pass: images of it show slightly other light."""
    return hashlib.sha256(f"{fingerprint} with thin glass".encode()).hexdigest()


def fingerprint_in_motion(fingerprint: str, motion: str) -> str:
    """Hash of a scene that moves, with the hash of its motion: it looks alike at no time for sure."""
    return hashlib.sha256(f"{fingerprint} moving by {motion}".encode()).hexdigest()


def fingerprint_at_depth(fingerprint: str, depth: int) -> str:
    """Hash of a scene whose path depth is not its own: images at another depth show other light."""
    return hashlib.sha256(f"{fingerprint} at depth {depth}".encode()).hexdigest()
