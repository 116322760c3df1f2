"""Files: written atomically and so that they outlast a crash, read within bounds, checked by checksums."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import math
import os
import platform
import secrets
import shutil
import stat
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError

# Files that are being written; the dot hides them from `*` in shells and from file dialogs.
PART_PREFIX = ".part-"
# Age at which a partial file of another machine, whose processes cannot be looked up, counts as left over.
_STALE_SECONDS = 24 * 3600.0
# No library chooses a format by a longer extension, and a longer one might not fit into a file's name.
_LONGEST_EXTENSION = 20
# Links from one to another, as many as Linux follows.
_MOST_LINKS = 40
# Of a JSON file: far more than any description of a camera, of a display, or of 100,000 frames has.
MOST_BYTES = 1 << 28
# Nothing that the project counts is as large as this, and larger numbers overflow where they meet floats.
_LARGEST = 2**63
_Value = TypeVar("_Value")


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Writes a file beside its target, then renames it, so that the target appears complete or not at all.

    Any number of processes may write to one folder, or one target, at the same time: the last one wins.
    Content and name are on the disk when this returns. Partial files of processes that died are removed.
    A link stays, and the file that it leads to is written. Pipes, character devices and open files such as
    /dev/stdout take the content as a stream.

    The folder is created; `write` gets a path with the target's extension. UserError if the target names no
    file, or cannot be written; no partial file is left.
    """
    if not path.name:
        raise UserError(f"{path}: names a folder, not a file")
    try:
        if (stream := _stream_of(path)) is not None:
            _write_to_stream(stream, path.name, write)
        else:
            _write_beside(Path(os.path.realpath(path)) if path.is_symlink() else path, write)
    except (OSError, RuntimeError, ValueError) as error:
        # A name that holds a NUL byte is a ValueError; one in what is written is the caller's.
        if isinstance(error, ValueError) and "\0" not in str(path):
            raise
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"{str(path)!r}"[1:-1] + f": cannot be written ({reason})") from error


def write_text(path: Path, text: str) -> None:
    """Writes a text file as UTF-8, whole or not at all; UserError if it cannot be written."""
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def _write_beside(path: Path, write: Callable[[Path], object]) -> None:
    # The extension stays: libraries choose the format by it.
    extension = path.suffix if len(path.suffix) <= _LONGEST_EXTENSION else ""
    # A name that no other write uses, made of the machine, the process, and random digits.
    part = path.with_name(f"{PART_PREFIX}{_place()}-{os.getpid()}-{secrets.token_hex(8)}{extension}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        for old in path.parent.glob(f"{PART_PREFIX}*"):
            # Another process may remove it as well.
            with contextlib.suppress(OSError):
                if _is_stale(old):
                    old.unlink()
        # Permissions that an ordinary new file gets there, without a change of the process's mask.
        part.touch(exist_ok=False)
        mode = stat.S_IMODE(part.stat().st_mode)
        # A writer that writes nothing must not leave an empty result.
        part.unlink()
        write(part)
        # Some libraries write files that only their owner may read.
        os.chmod(part, mode)
        with part.open("rb+") as written:
            os.fsync(written.fileno())
        os.replace(part, path)
        # The name as well, where the system can tell.
        with contextlib.suppress(OSError), _opened(path.parent) as folder:
            os.fsync(folder)
    finally:
        # Also after an interruption.
        with contextlib.suppress(OSError, ValueError):
            part.unlink()


def _stream_of(path: Path) -> Path | int | None:
    """What to open where a path leads to a pipe, a character device, or an open file, as /dev/stdout does."""
    link = path
    for _ in range(_MOST_LINKS):
        folder = os.path.realpath(link.parent)
        if folder in (f"/proc/{os.getpid()}/fd", "/dev/fd") and link.name.isdecimal():
            return int(link.name)
        if not link.is_symlink():
            break
        link = link.parent / os.readlink(link)
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return None
    return path if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode) else None


def _write_to_stream(target: Path | int, name: str, write: Callable[[Path], object]) -> None:
    """The stream gets all of the content or, if that cannot be made, nothing."""
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / name
        write(whole)
        # What was printed comes first, and what will be printed comes after.
        sys.stdout.flush()
        keeps = isinstance(target, int)
        with whole.open("rb") as source, open(target, "wb", closefd=not keeps) as stream:
            shutil.copyfileobj(source, stream)


@contextlib.contextmanager
def whole_folder(folder: Path, last: str) -> Iterator[Path]:
    """A folder to fill, which becomes the one that is named at the end, or is removed after an error.

    That must be missing or empty; an empty one stays, as it may be the working one or a link. `last` is moved
    last: without it, the content is not taken for whole. UserError if it is not empty, or cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UserError(f"{folder}: exists already; name another folder, or remove it")
    part = (folder if folder.is_dir() else folder.parent) / f"{PART_PREFIX}{secrets.token_hex(8)}"
    try:
        part.mkdir(parents=True)
        yield part
        if folder.is_dir():
            for made in sorted(part.iterdir(), key=lambda made: made.name == last):
                os.replace(made, folder / made.name)
        else:
            os.replace(part, folder)
    except OSError as error:
        raise UserError(f"{folder}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps other processes that ask for the same out of a folder, where the system can."""
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError, OSError):
            import fcntl

            # A process that dies gives the lock back.
            fcntl.flock(stack.enter_context(_opened(folder)), fcntl.LOCK_EX)
        yield


@contextlib.contextmanager
def _opened(folder: Path) -> Iterator[int]:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def require_size_below(path: Path, most_bytes: int) -> int:
    """Size of a file in bytes, asked for before it is read; OSError if there is none.

    ValueError if it is larger, or not an ordinary file: reading a device or a pipe might never end.
    """
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise ValueError("not a file")
    if found.st_size > most_bytes:
        raise ValueError(f"{found.st_size:,} bytes; at most {most_bytes:,} are read")
    return found.st_size


@functools.cache
def _place() -> str:
    """Eight hexadecimal digits for machine, boot and container; process numbers mean nothing elsewhere."""
    known = [platform.node()]
    with contextlib.suppress(OSError):
        known.append(Path("/proc/sys/kernel/random/boot_id").read_text())
    with contextlib.suppress(OSError):
        known.append(os.readlink("/proc/self/ns/pid"))
    return hashlib.sha256("\n".join(known).encode()).hexdigest()[:8]


def _is_stale(part: Path) -> bool:
    """Whether nobody writes a partial file any more."""
    place, _, rest = part.name.removeprefix(PART_PREFIX).partition("-")
    number = rest.partition("-")[0]
    # On other systems, signal 0 ends a process.
    if place == _place() and number.isdecimal() and os.name == "posix":
        try:
            os.kill(int(number), 0)
        except ProcessLookupError:
            return True
        except (PermissionError, OverflowError):
            return False
    return time.time() - part.lstat().st_mtime > _STALE_SECONDS


def read_json(path: Path, most_bytes: int = MOST_BYTES, finite: bool = True) -> dict[str, Any]:
    """The content of a JSON file of at most that many bytes; whether it is an object is not checked.

    Unless it must be `finite`, it may hold NaN and Infinity, which JSON does not have but Python writes.
    OSError if it cannot be read; ValueError if it is too large, not JSON, nested too deeply, or a number in
    it is too large.
    """
    require_size_below(path, most_bytes)
    # Some programs start texts with a byte order mark.
    return parse_json(path.read_text(encoding="utf-8-sig"), finite)


def parse_json(text: str, finite: bool = True) -> dict[str, Any]:
    """As `read_json`, of a text; ValueError if it is not JSON, too deep, or a number is too large."""
    constant = _refused if finite else float
    try:
        return json.loads(text, parse_int=_whole, parse_float=_number, parse_constant=constant)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def _whole(digits: str) -> int:
    # A limit of its own: conversion takes time with the square of the digits.
    value = int(digits) if len(digits) < 32 else _LARGEST
    if abs(value) >= _LARGEST:
        raise ValueError(f"{digits[:16]}... is too large a number")
    return value


def _number(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits[:16]} is too large a number")
    return value


def _refused(name: str) -> float:
    raise ValueError(f"{name} is not a number")


def checksum(arrays: Mapping[str, NDArray[Any]], text: str = "") -> str:
    """Eight hexadecimal digits of a CRC-32 over a text, and names, types, sizes and values of arrays."""
    state = zlib.crc32(text.encode())
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name])
        state = zlib.crc32(f"{name} {values.dtype} {values.shape}".encode(), state)
        state = zlib.crc32(values.reshape(-1).view(np.uint8).data, state)
    return f"{state:08x}"


def under(prefix: str, values: Mapping[str, _Value]) -> dict[str, _Value]:
    """The values whose names have a prefix, by their names without it."""
    return {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}


def json_text(content: object) -> str:
    """The content, of types that JSON has, as an indented document; null for numbers that are not finite."""
    return json.dumps(_finite(content), indent=1, allow_nan=False) + "\n"


def _finite(content: object) -> object:
    if isinstance(content, dict):
        return {name: _finite(value) for name, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
