"""Functions that Dr.Jit records once and replays, safe beside other threads and the garbage collector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import drjit as dr

from pathtrace.base.collector import collector_paused


class Frozen:
    """`dr.freeze` without two ways in which it stops or aborts the process (Dr.Jit 1.5).

    Dr.Jit holds its lock while it walks through arguments and results. For dataclasses this runs Python code,
    in which another thread may get its turn; if that one frees an array, it waits for Dr.Jit's lock and this
    one for the interpreter's, for ever. So dataclasses pass as plain tuples. And a garbage collection that
    frees a Mitsuba scene during a recording aborts the process. So there is none meanwhile.

    What the function takes from elsewhere than its arguments is part of the recording for good. Of scenes,
    everything in memory is: if another one is loaded or freed, the function is recorded once more.

    Args:
        function: takes and returns Dr.Jit arrays, Mitsuba's types, and dataclasses, tuples, lists and dicts
            of them, nested in any way. A dataclass must be made by its fields. Other values are part of the
            recording; their hash must not run Python code either.
    """

    def __init__(self, function: Callable[..., Any]):
        self._function = function
        self._recorded = dr.freeze(self._plain)

    def __call__(self, *arguments: Any) -> Any:
        with collector_paused():
            result = self._recorded(_flattened(arguments))
        return _rebuilt(result)

    @property
    def n_recordings(self) -> int:
        """Number of times that the function was recorded."""
        return int(self._recorded.n_recordings)

    def _plain(self, arguments: Any) -> Any:
        """The function from flattened arguments to a flattened result; frozen."""
        return _flattened(self._function(*_rebuilt(arguments)))


def _flattened(value: Any) -> Any:
    """Dataclasses, tuples and lists as tuples that start with their type, by which recordings differ."""
    kind = type(value)
    if is_dataclass(kind):
        return (kind, *(_flattened(getattr(value, field.name)) for field in fields(kind)))
    if kind in (tuple, list):
        return (kind, *map(_flattened, value))
    return {key: _flattened(part) for key, part in value.items()} if kind is dict else value


def _rebuilt(value: Any) -> Any:
    """What was flattened."""
    if type(value) is dict:
        return {key: _rebuilt(part) for key, part in value.items()}
    if type(value) is not tuple:
        return value
    kind, *parts = value
    rebuilt = map(_rebuilt, parts)
    if kind in (tuple, list):
        return kind(rebuilt)
    return kind(**{field.name: part for field, part in zip(fields(kind), rebuilt, strict=True)})
