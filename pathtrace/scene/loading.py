"""Loads Mitsuba scenes and turns what Mitsuba refuses into one-line errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi

from compose.base.errors import UserError


def load_mitsuba_dictionary(name: str, description: dict[str, Any]) -> Any:
    """A Mitsuba scene from a dictionary; `name` stands in error messages.

    Raises:
        UserError: Mitsuba refuses it, or it is not a scene.
    """
    return _checked(name, lambda: mi.load_dict(description))


def load_mitsuba_xml(path: Path, text: str) -> Any:
    """A Mitsuba scene from XML text, which names files relative to the folder of `path`.

    Mitsuba merges its meshes, by which tracing is twice as fast; shapes can no longer be told apart.

    Raises:
        UserError: Mitsuba refuses it, or it is not a scene.
    """
    return _checked(str(path), lambda: _load_text(text, path.parent))


def _checked(source: str, load: Callable[[], Any]) -> Any:
    try:
        loaded = load()
    except Exception as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        # Mitsuba's first lines name a position in its own code; the last one says what is wrong.
        raise UserError(f"{source}: Mitsuba refuses the scene: {lines[-1] if lines else error}") from error
    if isinstance(loaded, list) or not isinstance(loaded, mi.Scene):
        raise UserError(f"{source}: not a complete scene; the top element must be <scene>")
    return loaded


def _load_text(text: str, folder: Path) -> Any:
    resolver = mi.file_resolver()
    resolver.prepend(str(folder))
    try:
        return mi.load_string(text)
    finally:
        # The resolver is shared by the process; a folder left in it would shadow the next scene's files.
        remaining = [resolver[i] for i in range(len(resolver))][1:]
        resolver.clear()
        for entry in remaining:
            resolver.append(entry)
