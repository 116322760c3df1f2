"""Names and hashes of scenes, as files claim them: they become parts of paths, so they must not be paths."""

from __future__ import annotations

import re
from typing import Any

# A folder's name has at most 255 bytes, and a part of the hash follows.
_LONGEST_NAME = 200
_HASH = re.compile(r"[0-9a-f]{0,64}")


def claimed_scene(name: Any, digest: Any) -> tuple[str, str]:
    """Name and hash of a scene, if they can be those of one.

    Args:
        name: at most 200 bytes of printable characters, neither slash nor backslash, no dot in front.
        digest: up to 64 hexadecimal digits in lower case; empty for what fits any scene.

    Raises:
        ValueError: they cannot.
    """
    good = isinstance(name, str) and name.isprintable() and not set("/\\") & set(name)
    if not good or name.startswith(".") or len(name.encode()) > _LONGEST_NAME:
        raise ValueError(f"scene name {str(name)[:40]!r} must be printable, short, and no path")
    if not isinstance(digest, str) or not _HASH.fullmatch(digest):
        raise ValueError(f"scene hash {str(digest)[:40]!r} must be up to 64 hexadecimal digits")
    return name, digest
