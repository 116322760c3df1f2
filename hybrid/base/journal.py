"""The results so far of an evaluation or a sweep, from which it resumes if interrupted."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from compose.base.errors import UserError, one_line
from compose.base.files import locked, read_json, write_whole
from hybrid.base.identity import require_same

_CHECKSUM = "crc32"
# More than the results of thousands of evaluations.
_MOST_BYTES = 1 << 30


class Journal:
    """Named results in one JSON file, which is created when the first one is saved.

    The identity is everything that the results depend on, in types that JSON has. UserError if the file is
    damaged, or belongs to another identity.
    """

    def __init__(self, path: Path, identity: dict[str, Any]):
        self._path = path
        self._identity = identity
        self._results = self._stored()

    def once(self, name: str, make: Callable[[], Any]) -> Any:
        """The result with that name; computed and saved if there is none yet."""
        if name not in self:
            self[name] = make()
        return self[name]

    def __contains__(self, name: str) -> bool:
        return name in self._results

    def __getitem__(self, name: str) -> Any:
        return self._results[name]

    def __setitem__(self, name: str, result: Any) -> None:
        """Saves the result at once."""
        self._results[name] = result
        self.write()

    def remove(self) -> None:
        """Deletes the file when the work is complete."""
        self._path.unlink(missing_ok=True)

    def write(self) -> None:
        """Saves all results, beside those that another process saved meanwhile.

        Needed only after a result was changed in place. UserError if the file cannot be written, is damaged,
        or belongs to another identity by now.
        """
        content = {"identity": self._identity, "results": self._results}
        # What JSON cannot hold is noticed before anything is touched.
        json.dumps(content)
        try:
            with locked(self._path.parent):
                self._results |= {n: r for n, r in self._stored().items() if n not in self._results}
                text = json.dumps({**content, _CHECKSUM: _checksum(content)}) + "\n"
                write_whole(self._path, lambda part: part.write_text(text, encoding="utf-8"))
        except OSError as error:
            raise UserError(f"{self._path}: cannot be written ({error.strerror})") from error

    def _stored(self) -> dict[str, Any]:
        """The results in the file; empty if there is none."""
        try:
            # Python writes infinities, such as the PSNR of equal images.
            found = read_json(self._path, _MOST_BYTES, finite=False)
            theirs, results = dict(found["identity"]), dict(found["results"])
            if found.pop(_CHECKSUM, None) not in (None, _checksum(found)):
                raise ValueError("the checksum differs")
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UserError(
                f"{self._path}: is damaged ({one_line(repr(error))}); delete it to start again"
            ) from error
        what, advice = f"{self._path.parent}: holds results", "choose another folder"
        require_same(theirs, self._identity, what, advice)
        return results


def _checksum(content: dict[str, Any]) -> str:
    """Eight hexadecimal digits of what JSON says of a content."""
    return f"{zlib.crc32(json.dumps(content, sort_keys=True).encode()):08x}"
