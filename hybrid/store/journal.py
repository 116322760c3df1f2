"""The results so far of an evaluation or a sweep, from which it resumes if interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from compose.base.errors import UserError
from compose.base.files import write_whole
from hybrid.store.identity import require_same


class Journal:
    """Named results in one JSON file.

    Args:
        path: the file; created when the first result is saved.
        identity: everything that the results depend on, in types that JSON has.

    Raises:
        UserError: the file is damaged, or belongs to another identity.
    """

    def __init__(self, path: Path, identity: dict[str, Any]):
        self._path = path
        self._content: dict[str, Any] = {"identity": identity, "results": {}}
        if not path.exists():
            return
        try:
            found = json.loads(path.read_text())
            theirs = dict(found["identity"])
            dict(found["results"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UserError(f"{path}: is damaged ({error!r}); delete it to start again") from error
        what, advice = f"{path.parent}: holds results", "choose another folder"
        require_same(theirs, identity, what, advice)
        self._content = found

    def once(self, name: str, make: Callable[[], Any]) -> Any:
        """The result with that name; computed and saved if there is none yet."""
        if name not in self:
            self[name] = make()
        return self[name]

    def __contains__(self, name: str) -> bool:
        return name in self._content["results"]

    def __getitem__(self, name: str) -> Any:
        return self._content["results"][name]

    def __setitem__(self, name: str, result: Any) -> None:
        """Saves the result at once."""
        self._content["results"][name] = result
        self.write()

    def remove(self) -> None:
        """Deletes the file when the work is complete."""
        self._path.unlink(missing_ok=True)

    def write(self) -> None:
        """Saves all results; required only after a result was changed in place."""
        text = json.dumps(self._content) + "\n"
        write_whole(self._path, lambda part: part.write_text(text))
