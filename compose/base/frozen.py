"""Functions that Dr.Jit records once and replays, safe beside other threads and the garbage collector."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from threading import Lock
from typing import Any, Generic, TypeVar, cast

import drjit as dr

# Recordings of a function that are kept, and from how many made Dr.Jit would take them for a mistake.
_KEPT, _MANY = 64, 1 << 30
# Types of values that are told apart by their value, not as objects.
_PLAIN = {bool, int, float, str}
# Sizes per octave that arrays are rounded up to, and the least one.
_PER_OCTAVE, _LEAST = 4, 1024
_Result = TypeVar("_Result")
_lock = Lock()
# Pauses under way, in all threads, and whether the collector ran before the first of them.
_pauses = 0
_was_enabled = False


def capacity(count: int) -> int:
    """A size of an array for so many elements, at most a fifth too large: recordings differ by size.

    Lanes beyond the elements are masked.
    """
    if count <= _LEAST:
        return _LEAST
    return 16 * math.ceil(2 ** (math.ceil(_PER_OCTAVE * math.log2(count)) / _PER_OCTAVE) / 16)


@contextmanager
def collector_paused() -> Iterator[None]:
    """No automatic collection inside, in any thread; pauses may overlap and lie inside each other."""
    global _pauses, _was_enabled
    with _lock:
        if not _pauses:
            _was_enabled = gc.isenabled()
            gc.disable()
        _pauses += 1
    try:
        yield
    finally:
        with _lock:
            _pauses -= 1
            if not _pauses and _was_enabled:
                gc.enable()


@contextmanager
def interrupted_by_ctrl_c() -> Iterator[None]:
    """Raises Ctrl-C as KeyboardInterrupt where Dr.Jit calls Python, which makes it a RuntimeError."""
    try:
        yield
    except RuntimeError as error:
        cause: BaseException | None = error
        while isinstance(cause, RuntimeError):
            cause = cause.__cause__
        if isinstance(cause, KeyboardInterrupt):
            raise cause from None
        raise


@dataclass(frozen=True)
class AnySize:
    """Arrays that may have other widths in the same recording: only to be gathered from.

    No kernel that reads them may have as many lanes as one of them is wide, or a multiple of that: Dr.Jit
    would take it for elementwise.
    """

    arrays: list[Any]


class Passed:
    """An argument that says what stands for it in a recording."""

    # Its type, itself, a string by which recordings differ, and arrays; of any width.
    flat: tuple[Any, ...]
    value: Any  # what the function gets


class Frozen(Generic[_Result]):
    """`dr.freeze` without five faults of Dr.Jit 1.5.

    - Dr.Jit holds its lock while it walks through arguments and results. For dataclasses this runs Python
      code, in which another thread may get its turn; if that one frees an array, both wait for ever. So
      dataclasses pass as plain tuples.
    - A garbage collection that frees a Mitsuba scene during a recording aborts the process: it is paused.
    - Of a number or string that occurs a second time, Dr.Jit only knows that it did: (True, False, True) was
      replayed for (True, False, False). So there is a hash of them all.
    - Sums that kernels scatter to have a copy for each thread that there was when they were recorded; further
      threads would write beyond them. So recordings differ by the number of threads.
    - Ctrl-C while it walks through arguments and results becomes a RuntimeError: it is raised again.

    What the function takes from elsewhere than its arguments is part of the recording for good. Arrays that
    it writes to must be made inside it: others are copied.

    Args:
        function: takes and returns Dr.Jit arrays, Mitsuba's types, and dataclasses, tuples, lists and dicts
            of them, nested in any way. A dataclass must be made by its fields. Other values are part of the
            recording; their hash must not run Python code either.
        by_size: whether arguments of other widths are recorded anew. A recording has the numbers of lanes of
            its first call, and the sizes of arrays made in it, but for what follows elementwise from one of
            its arguments.
    """

    def __init__(self, function: Callable[..., _Result], by_size: bool = False):
        self._function, self._by_size = function, by_size
        self._recorded = dr.freeze(self._plain, limit=_KEPT, warn_after=_MANY)

    def __call__(self, *arguments: object) -> _Result:
        with collector_paused():
            return self.replayed(arguments)

    def replayed(self, arguments: tuple[object, ...]) -> _Result:
        """The result; the collector is paused."""
        flat = _flattened(arguments)
        with interrupted_by_ctrl_c():
            found = self._recorded(flat, hash((_key(flat, self._by_size), dr.thread_count())))
        return cast("_Result", _rebuilt(found))

    def _plain(self, arguments: object, key: int) -> object:
        """The function from flattened arguments to a flattened result; frozen."""
        return _flattened(self._function(*cast("tuple[object, ...]", _rebuilt(arguments))))


def _flattened(value: object) -> object:
    """Dataclasses, tuples and lists as tuples that start with their type, by which recordings differ."""
    kind: type = type(value)
    if type(value) is tuple or type(value) is list:
        return (kind, *map(_flattened, value))
    if type(value) is dict:
        return {key: _flattened(part) for key, part in value.items()}
    if isinstance(value, Passed):
        return value.flat
    names = _names(kind)
    return value if names is None else (kind, *[_flattened(getattr(value, name)) for name in names])


def _rebuilt(value: object) -> object:
    if type(value) is dict:
        return {key: _rebuilt(part) for key, part in value.items()}
    if type(value) is not tuple:
        return value
    kind, *parts = value
    if issubclass(kind, Passed):
        return parts[0].value
    names, whole = _names(kind), map(_rebuilt, parts)
    return kind(whole) if names is None else kind(**dict(zip(names, whole, strict=True)))


def _key(value: object, by_size: bool) -> Hashable:
    """Values in what was flattened and, if recordings differ by them, widths of all arrays."""
    if type(value) is tuple:
        kind, *parts = value
        if issubclass(kind, Passed):
            return parts[1]
        by_size = by_size and kind is not AnySize
        return kind, *[_key(part, by_size) for part in parts]
    if type(value) is dict:
        return tuple([_key(part, False) for part in value.values()])
    if isinstance(value, dr.ArrayBase):
        return dr.width(value) if by_size else None
    return (type(value), value) if type(value) in _PLAIN else None


@cache
def _names(kind: type) -> tuple[str, ...] | None:
    """The fields of a dataclass; None for other types."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else None
