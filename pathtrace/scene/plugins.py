"""Where Mitsuba's plugins come from: they are native code, and Mitsuba looks in a scene's folder as well."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import mitsuba as mi

from compose.base.errors import UserError


def mitsuba_folder() -> Path:
    """The folder of Mitsuba's own plugins and data."""
    return Path(mi.__file__).parent


def require_own_plugins(source: Path, types: Iterable[str], folders: Iterable[Path]) -> None:
    """Checks that no plugin of a scene would be loaded from its own files.

    Args:
        source: the scene's XML file, for the message.
        types: of its elements.
        folders: in which Mitsuba looks for files.

    Raises:
        UserError: a type is a path or unknown, or a file of that name lies in one of the folders.
    """
    own = {path.stem for path in (mitsuba_folder() / "plugins").iterdir()}
    searched = [folder / "plugins" for folder in (*folders, Path())]
    found = {path.stem for folder in searched if folder.is_dir() for path in folder.iterdir()}
    for kind in sorted(types):
        if set("/\\$\0") & set(kind) or (kind not in own and kind in found):
            raise UserError(
                f"{source}: type {kind[:80]!r} is no plugin of Mitsuba; a scene may not bring its own code"
            )
