"""The fingerprint of a scene: a hash of all that it is made of."""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ET
from pathlib import Path


def fingerprint(path: Path, root: ET.Element) -> str:
    digest = hashlib.sha256(path.read_bytes())
    for element in root.iter("string"):
        file = path.parent / (element.get("value") or "")
        if element.get("name") == "filename" and file.is_file():
            digest.update(file.read_bytes())
    return digest.hexdigest()
