"""Names for the files that the window writes."""

from __future__ import annotations

from pathlib import Path

from compose.base.errors import UserError


def unused_file(folder: Path, name: str, suffix: str) -> Path:
    """FOLDER/NAME-001SUFFIX, with the lowest number that no file there has yet.

    Raises:
        UserError: the folder cannot be read.
    """
    number = 1
    try:
        while (folder / f"{name}-{number:03d}{suffix}").exists():
            number += 1
    except OSError as error:
        raise UserError(f"{folder}: cannot be read ({error.strerror})") from error
    return folder / f"{name}-{number:03d}{suffix}"
