"""Values by names that have a prefix."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

_Value = TypeVar("_Value")


def under(prefix: str, values: Mapping[str, _Value]) -> dict[str, _Value]:
    """The values whose names have a prefix, by their names without it."""
    return {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}
