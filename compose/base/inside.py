"""Names of files that a document lists: they never lead out of the document's folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

# Bytes, of any part of a path on common systems.
_LONGEST_NAME = 255


def file_inside(folder: Path, name: Any) -> Path:
    """A file by its name relative to a folder.

    Raises:
        ValueError: it would lie elsewhere, or can be none.
    """
    is_name = isinstance(name, str) and name.isprintable() and len(name.encode()) <= _LONGEST_NAME
    if not is_name or Path(name).is_absolute() or ".." in Path(name).parts:
        raise ValueError(f"{str(name)[:80]!r} is not the name of a file in the folder")
    return folder / name
