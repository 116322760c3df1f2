"""Errors that a user can cause, and checks of what users and files claim: seeds, sizes and names."""

from __future__ import annotations

import operator
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import SupportsIndex, TypeGuard

# Of an image: 16 times those of 4K.
MOST_PIXELS = 1 << 27
# The largest integer of 64 bits: what seeds are saved as.
MOST_SEED = (1 << 63) - 1
# Bytes of a scene's name: a folder's name has at most 255, and a part of the hash follows.
_LONGEST_NAME = 200
# Bytes of any part of a path on common systems.
_LONGEST_PART = 255
_HASH = re.compile(r"[0-9a-f]{0,64}")


class UserError(Exception):
    """Bad input: one line that names the file or value, what is wrong with it and what would be right."""


def one_line(error: BaseException | str) -> str:
    """What an error says, short and on one line, for a message that names the file itself."""
    said = getattr(error, "strerror", None) or str(error) or type(error).__name__
    # A file's content may be part of it.
    line = "".join(c if c.isprintable() else " " for c in said)
    return line if len(line) <= 300 else f"{line[:300]}..."


@contextmanager
def reading(path: object) -> Iterator[None]:
    """Turns an OSError or ValueError inside into a UserError that says which file cannot be read."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read ({one_line(error)})") from error


def require_seed(seed: SupportsIndex) -> int:
    """Checks a seed before any work; UserError unless it is a whole number from 0 to MOST_SEED."""
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if not 0 <= number <= MOST_SEED:
        raise UserError(f"seed {seed}: must be a whole number from 0 to {MOST_SEED}")
    return number


def as_plain_numbers(settings: object) -> None:
    """Makes numbers of NumPy in an object's attributes Python's own, which JSON and checks of types take."""
    plain = lambda value: value.item() if getattr(value, "shape", None) == () else value  # noqa: E731
    for name, value in vars(settings).items():
        found = tuple(map(plain, value)) if type(value) is tuple else plain(value)
        if found is not value:
            # Of a frozen dataclass, too.
            object.__setattr__(settings, name, found)


def claimed_scene(name: object, digest: object) -> tuple[str, str]:
    """Name and hash of a scene, which become parts of paths, so they must not be paths; else ValueError.

    A name is at most 200 bytes of printable characters, without slashes, backslashes, or a leading dot. A
    hash has up to 64 hexadecimal digits in lower case, none for what fits any scene.
    """
    if not _is_name(name, _LONGEST_NAME) or name.startswith(".") or set("/\\") & set(name):
        raise ValueError(f"scene name {str(name)[:40]!r} must be printable, short, and no path")
    if not isinstance(digest, str) or not _HASH.fullmatch(digest):
        raise ValueError(f"scene hash {str(digest)[:40]!r} must be up to 64 hexadecimal digits")
    return name, digest


def _is_name(value: object, most_bytes: int) -> TypeGuard[str]:
    return isinstance(value, str) and value.isprintable() and len(value.encode()) <= most_bytes


def scene_name(wanted: str, otherwise: str) -> str:
    """What is left of a name as that of a scene, for which see `claimed_scene`; `otherwise` if nothing is."""
    plain = "".join(c if c.isprintable() and c not in "/\\" else "_" for c in wanted).lstrip(".")
    return plain.encode()[:_LONGEST_NAME].decode(errors="ignore") or otherwise


def file_inside(folder: Path, name: object) -> Path:
    """A file by its name relative to a folder; ValueError if it would lie outside, or is not a file name."""
    if not _is_name(name, _LONGEST_PART) or Path(name).is_absolute() or ".." in Path(name).parts:
        raise ValueError(f"{str(name)[:80]!r} is not the name of a file in the folder")
    return folder / name
