"""Notices that the files of a scene have changed."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TypeAlias

from compose.base.errors import UserError
from pathtrace.scene.scene import files_of_scene

# Seconds between two looks. Folders of other machines tell nobody of their changes.
_EVERY = 0.5

_Stamps: TypeAlias = dict[Path, tuple[int, int]]


class SceneWatch:
    """Looks now and then at the files of a scene, given as in `load_scene`."""

    def __init__(self, source: str | Path):
        self._source, self._files = source, files_of_scene(source)
        self._seen: _Stamps = {}
        self._known = self._seen = self._stamps()
        self._next = 0.0

    def changed(self) -> bool:
        """Whether files have changed since the last time, and are no longer being written.

        What files there are is asked of the scene after a change only: its XML may have megabytes.
        """
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + _EVERY
        before, self._seen = self._seen, self._stamps()
        if self._seen == self._known or self._seen != before:
            return False
        try:
            self._files = files_of_scene(self._source)
        except UserError:
            return False  # until it can be read
        self._known = self._seen = self._stamps()
        return True

    def _stamps(self) -> _Stamps:
        """Times and sizes of the files; as before while one of them is missing."""
        try:
            return {file: _stamp(file) for file in self._files}
        except OSError:
            return self._seen


def _stamp(file: Path) -> tuple[int, int]:
    found = file.stat()
    return found.st_mtime_ns, found.st_size
