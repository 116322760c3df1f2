"""Arrays of numbers in a glTF file (specification, 3.6.2)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathtrace.gltf.document import Document

Array = NDArray[np.float64]

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
# One that is all zeros can be declared without any data.
_MOST_NUMBERS = 1 << 28


def read_array(document: Document, index: int, columns: int | tuple[int, ...], user: str) -> Array:
    """The (N, columns) numbers of an accessor; integers that stand for fractions are these fractions.

    Args:
        document: the file.
        index: of the accessor.
        columns: that it must have, or may have.
        user: what refers to it, in error messages.

    Raises:
        UserError: there is none, it has other columns, lies outside of its buffer, or holds NaN or infinity.
    """
    accessor, name = document.item("accessors", index, user), f"accessors[{index}] of {user}"
    found = _COLUMNS.get(accessor["type"])
    kind = _TYPES.get(accessor["componentType"])
    allowed = (columns,) if isinstance(columns, int) else columns
    if found not in allowed or kind is None:
        raise document.refused(f"{name} is a {accessor['type']} of type {accessor['componentType']}")
    count = int(accessor["count"])
    if count * found > _MOST_NUMBERS:
        raise document.refused(f"{name} has {count:,} elements")
    values = np.zeros((count, found), kind)
    if "bufferView" in accessor:
        values = _viewed(document, accessor, kind, (count, found), name)
    if "sparse" in accessor:
        values = values.copy()
        _replace(document, accessor["sparse"], values, name)
    fractions = _fractions(values) if accessor.get("normalized") else values.astype(np.float64)
    if not np.isfinite(fractions).all():
        raise document.refused(f"{name} holds numbers that are not finite")
    return fractions


def read_view(document: Document, index: int, user: str) -> tuple[bytes, int | None]:
    """The bytes of a buffer view and its stride."""
    view = document.item("bufferViews", index, user)
    document.item("buffers", view["buffer"], f"bufferViews[{index}]")
    buffer, start = document.buffers[int(view["buffer"])], int(view.get("byteOffset", 0))
    end = start + int(view["byteLength"])
    if end > len(buffer):
        raise document.refused(f"bufferViews[{index}] of {user} ends beyond its buffer")
    return buffer[start:end], view.get("byteStride")


def _viewed(
    document: Document, part: dict[str, Any], kind: str, shape: tuple[int, int], user: str
) -> NDArray[Any]:
    """Numbers in a buffer view."""
    content, stride = read_view(document, part["bufferView"], user)
    size = np.dtype(kind).itemsize
    start, row = int(part.get("byteOffset", 0)), int(stride or size * shape[1])
    if start + (shape[0] - 1) * row + size * shape[1] > len(content):
        raise document.refused(f"{user} ends beyond its buffer view")
    return np.ndarray(shape, kind, content, start, (row, size))


def _replace(document: Document, sparse: dict[str, Any], values: NDArray[Any], user: str) -> None:
    """Writes the elements of a sparse accessor over those that it is based on."""
    count, indices = int(sparse["count"]), sparse["indices"]
    kind = _TYPES.get(indices["componentType"], "<u4")
    where = _viewed(document, indices, kind, (count, 1), user)[:, 0].astype(np.int64)
    if where.min() < 0 or where.max() >= len(values):
        raise document.refused(f"{user} replaces elements that it does not have")
    values[where] = _viewed(document, sparse["values"], values.dtype.str, (count, values.shape[1]), user)


def _fractions(values: NDArray[Any]) -> Array:
    """Integers as fractions of the largest one (3.6.2.2); floats as they are."""
    if values.dtype.kind == "f":
        return values.astype(np.float64)
    return np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)
