"""JSON files of posed images, and what goes wrong in them in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from compose.base.errors import UserError, one_line
from compose.base.json_file import read_json


def document(path: Path) -> Any:
    """The content of a JSON file.

    Raises:
        UserError: it is missing, cannot be read, or is no JSON.
    """
    try:
        return read_json(path)
    except FileNotFoundError as error:
        raise UserError(f"{path}: this file is missing") from error
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: not a JSON file that can be read ({one_line(error)})") from error


@contextmanager
def described_by(path: Path, what: str = "") -> Iterator[None]:
    """Says of a mistake in a file's content which file it is in, and of what, such as "frame 3"."""
    try:
        yield
    except KeyError as error:
        raise UserError(f"{path}: {what or 'it'} has no {one_line(error)}") from error
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
        raise UserError(f"{path}: {what + ': ' if what else ''}{one_line(error)}") from error


def time_of(value: Any) -> float:
    """A time; ValueError if it is not from 0 to 1."""
    time = float(value)
    if not 0 <= time <= 1:
        raise ValueError(f"time {time:g}: must be from 0 to 1")
    return time
