"""Reads JSON files that others wrote."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from compose.base.files import require_size_below

# Far more than any description of a camera, of a display, or of 100,000 frames has.
MOST_BYTES = 1 << 28
# Whole numbers beyond are none that the project counts, and overflow where they meet floats.
_LARGEST = 2**63


def read_json(path: Path, most_bytes: int = MOST_BYTES, finite: bool = True) -> Any:
    """The content of a JSON file.

    Args:
        path: the file.
        most_bytes: larger files are refused before they are read.
        finite: whether to refuse NaN and Infinity, which JSON does not have but Python writes.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is too large, not JSON, nested too deeply, or a number in it is too large.
    """
    require_size_below(path, most_bytes)
    return parse_json(path.read_text(encoding="utf-8"), finite)


def parse_json(text: str, finite: bool = True) -> Any:
    """The content of a JSON text.

    Raises:
        ValueError: it is not JSON, nested too deeply, or a number in it is too large.
    """
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
