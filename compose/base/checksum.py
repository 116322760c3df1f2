"""Checksums of arrays, by which a file's reader notices a flipped bit."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def checksum(arrays: Mapping[str, NDArray[Any]], text: str = "") -> str:
    """Eight hexadecimal digits of a CRC-32 over names, types, sizes and values of arrays.

    Args:
        arrays: by name, in any order.
        text: what else it covers.
    """
    state = zlib.crc32(text.encode())
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name])
        state = zlib.crc32(f"{name} {values.dtype} {values.shape}".encode(), state)
        state = zlib.crc32(values.reshape(-1).view(np.uint8).data, state)
    return f"{state:08x}"
