"""Writes files atomically."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path

from compose.base.errors import UserError


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Writes a file beside its target, then renames it, so that the target appears complete or not at all.

    Args:
        path: the target; its folder is created.
        write: writes the content to the path it is given, which has the target's extension.

    Raises:
        UserError: the path names no file, or it cannot be written; no partial file is left.
    """
    if not path.name:
        raise UserError(f"{path}: names a folder, not a file")
    # The extension is kept: libraries choose the format by it.
    part = path.with_name(f".part-{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(part)
        os.replace(part, path)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"{path}: cannot be written ({reason})") from error
    finally:
        # Also after an interruption.
        with contextlib.suppress(OSError):
            part.unlink()
