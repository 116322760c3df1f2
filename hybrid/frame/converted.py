"""Dataclass fields that accept a value in several forms and keep it in one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

Given = TypeVar("Given")
Kept = TypeVar("Kept")


class Converted(Generic[Given, Kept]):
    """A dataclass field that converts what the constructor is given.

    Args:
        convert: called with the given value; raises for values that cannot be converted.
        default: of the field.
    """

    def __init__(self, convert: Callable[[Given], Kept], default: Kept):
        self._convert, self._default = convert, default

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = f"_{name}"

    def __get__(self, instance: Any, owner: type | None = None) -> Kept:
        # Dataclasses read a field's default from the class.
        kept: Kept = self._default if instance is None else instance.__dict__[self._name]
        return kept

    def __set__(self, instance: Any, value: Given) -> None:
        instance.__dict__[self._name] = self._convert(value)
