"""Multi-channel OpenEXR files of one part in scan lines: what the project writes and reads."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from compose.base.errors import MOST_PIXELS
from compose.base.files import checksum, require_size_below, write_whole

_MOST_CHANNELS = 256
_MOST_BYTES = 1 << 34
_MOST_HEADER = 1 << 20
# The file type, and version 2.
_MAGIC = b"\x76\x2f\x31\x01\x02"
# Bytes of a value by its type: unsigned integer, half, float.
_TYPES = {0: 4, 1: 2, 2: 4}
# Compression 0, 2 and 3: none, and ZIP of one and of 16 lines. Deflate shrinks data 1,032 times at most.
_COMPRESSIONS, _MOST_RATIO = (0, 2, 3), 1032
_CHECKSUM = "crc32"


def write_channels(
    path: Path, channels: Mapping[str, NDArray[Any]], attributes: Mapping[str, str] | None = None
) -> None:
    """Writes channels (H, W) of uint32, float16 or float32 with ZIP compression; UserError on failure.

    The file appears whole or not at all. Its header gets a checksum of the values, by which a reader notices
    damage, and further attributes.
    """
    content = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        _CHECKSUM: checksum(content),
        **(attributes or {}),
    }
    write_whole(path, lambda part: OpenEXR.File(header, content).write(str(part)))


def read_channels(path: Path, size: tuple[int, int] | None = None) -> dict[str, NDArray[Any]]:
    """All channels (H, W) by name, of an image that must have a `size` in pixels: width and height.

    OSError if it cannot be read; ValueError if it is not an EXR file of one part in scan lines, damaged, of
    another size, or declares more than its bytes can hold: nothing is allocated before that is known.
    """
    width, height = _declared_size(path)
    if size is not None and (width, height) != size:
        raise ValueError(f"{width} x {height} pixels instead of {size[0]} x {size[1]}")
    try:
        file = OpenEXR.File(str(path), separate_channels=True)
        channels = {name: channel.pixels for name, channel in file.channels().items()}
        expected = file.header().get(_CHECKSUM)
    except (RuntimeError, TypeError, KeyError) as error:
        raise ValueError(str(error)) from error
    if any(values.shape != (height, width) for values in channels.values()):
        raise ValueError("channels of other sizes than the image")
    if expected is not None and expected != checksum(channels):
        raise ValueError("the checksum differs")
    return channels


def _declared_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels that the header declares, after a check that the file can hold them."""
    size = require_size_below(path, _MOST_BYTES)
    with path.open("rb") as file:
        content = file.read(_MOST_HEADER)
    attributes, end = _attributes(content)
    try:
        left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
        (compression,) = attributes["compression"]
        channels = _channels(attributes["channels"])
    except (KeyError, ValueError, struct.error) as error:
        raise ValueError(f"header is damaged ({error})") from error
    width, height = right - left + 1, bottom - top + 1
    if width < 1 or height < 1 or width * height > MOST_PIXELS or not 1 <= len(channels) <= _MOST_CHANNELS:
        declared = f"{width} x {height} pixels in {len(channels)} channels"
        raise ValueError(f"declares {declared}; at most {MOST_PIXELS:,} in {_MOST_CHANNELS} are read")
    if compression not in _COMPRESSIONS:
        raise ValueError("compressed neither by ZIP nor at all")
    declared = width * height * sum(channels.values())
    ratio = _MOST_RATIO if compression else 1
    # A table of offsets comes before the lines; 16 lines at most share one.
    if declared > (size - end) * ratio or height // 16 * 8 > size - end:
        raise ValueError(f"truncated: declares {width} x {height} pixels, more than {size:,} bytes can hold")
    return width, height


def _attributes(content: bytes) -> tuple[dict[str, bytes], int]:
    """Values of a header's attributes by name, and where it ends."""
    # Bit 10 of the version allows names of up to 255 bytes; others are tiles, deep images and several parts.
    if content[:5] != _MAGIC or len(content) < 8 or content[5] & ~0x04 or any(content[6:8]):
        raise ValueError("not an EXR file of one part in scan lines")
    found: dict[str, bytes] = {}
    at = 8
    while content[at : at + 1] != b"\0":
        name, at = _text(content, at)
        _, at = _text(content, at)
        if at + 4 > len(content):
            raise ValueError("header is truncated")
        (length,) = struct.unpack_from("<i", content, at)
        at += 4
        if length < 0 or at + length > len(content):
            raise ValueError("header is truncated, or longer than a header may be")
        if name in found:
            raise ValueError(f"header names {name} twice")
        found[name] = content[at : at + length]
        at += length
    return found, at + 1


def _channels(content: bytes) -> dict[str, int]:
    """Bytes of a value of each channel by name."""
    found: dict[str, int] = {}
    at = 0
    while content[at : at + 1] != b"\0":
        name, at = _text(content, at)
        kind, _, x, y = struct.unpack_from("<iiii", content, at)
        if kind not in _TYPES or (x, y) != (1, 1) or name in found:
            raise ValueError(f"channel {name!r} is of no known type, at lower resolution, or named twice")
        found[name] = _TYPES[kind]
        at += 16
    return found


def _text(content: bytes, at: int) -> tuple[str, int]:
    """The text that ends with a zero byte, and where the next entry begins."""
    end = content.find(b"\0", at, at + 256)
    if end <= at:
        raise ValueError("header is truncated")
    return content[at:end].decode("utf-8", "replace"), end + 1
