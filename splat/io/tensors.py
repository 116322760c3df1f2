"""Tensors with metadata in safetensors files, and without loss in fewer bytes.

Packed, bytes of equal significance lie side by side, then DEFLATE. On a trained forest, LZMA takes 9 % less
room and six times as long to read; Zstandard takes as much room.
"""

from __future__ import annotations

import json
import math
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from compose.base.errors import UserError, one_line
from compose.base.files import checksum, parse_json, require_size_below, write_whole

FORMAT_VERSION = 2
# That of forests in coordinates of their own, which programs that read version 2 alone would misplace.
PLACED_VERSION = 3
# That of forests of which only some nodes have directional harmonics, or whose tensors are codes.
COMPACT_VERSION = 4
# That of forests that are not blended in linear radiance, which earlier programs would draw too bright.
BLENDED_VERSION = 5
_VERSIONS = (FORMAT_VERSION, PLACED_VERSION, COMPACT_VERSION, BLENDED_VERSION)
_METADATA, _CHECKSUM = "hybrid", "crc32"
# Says that there is a checksum: otherwise, one whose name is damaged would be none.
_CHECKED = "checked"
# 40 million Gaussians of degree 3 are 10 GB.
_MOST_BYTES = 1 << 36
# Of a file that others replace all the time.
_MOST_TRIES = 20
# What the library raises: for headers, for types that torch has not, for text that is not UTF-8.
_REFUSALS = (SafetensorError, OSError, ValueError, TypeError, KeyError, RuntimeError, AttributeError)


def save_tensors(path: Path, tensors: dict[str, torch.Tensor], metadata: dict[str, Any]) -> None:
    """Writes tensors by name and metadata, which JSON can hold, atomically, with a checksum of both.

    UserError if the file cannot be written.
    """
    contiguous = {name: tensor.contiguous() for name, tensor in tensors.items()}
    digest = _checksum(contiguous, json.dumps(metadata))
    # A single entry: the library writes several in random order, and equal files would differ.
    text = json.dumps({_CHECKSUM: digest, **metadata, _CHECKED: True})
    # The library's own file writing leaves a file of another name behind if the process dies meanwhile.
    content = save(contiguous, {_METADATA: text})
    write_whole(path, lambda part: part.write_bytes(content))


def load_tensors(
    path: Path, advice: str = "make it again", with_tensors: bool = True
) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Reads the tensors and the metadata of a file written by `save_tensors`.

    Both are of one and the same file, also if another process replaces it meanwhile. Without its tensors, a
    large file takes no longer than a small one.

    UserError if the file is missing, corrupt (`advice` says what to do then) or of another version.
    """
    for _ in range(_MOST_TRIES):
        before = _version(path)
        try:
            found = _load_once(path, advice, with_tensors)
        except UserError:
            if _version(path) == before:
                raise
            continue
        if _version(path) == before:
            return found
    return _load_once(path, advice, with_tensors)


def _version(path: Path) -> tuple[int, ...] | None:
    """What tells a file from another one of its name: it is opened twice, for header and tensors."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_size


def _load_once(path: Path, advice: str, with_tensors: bool) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    if not path.is_file():
        raise UserError(f"{path}: no such file")
    try:
        require_size_below(path, _MOST_BYTES)
        # The library checks that the declared places lie in the file, one after the other.
        with safe_open(path, framework="pt") as file:
            entries = file.metadata() or {}
            names = list(file.keys()) if with_tensors else []
            tensors = {name: file.get_tensor(name) for name in names}
        metadata = parse_json(entries.get(_METADATA, "{}"), finite=False)
        if not isinstance(metadata, dict):
            raise ValueError("metadata is no JSON object")
        digest, checked = (metadata.pop(name, None) for name in (_CHECKSUM, _CHECKED))
        has_checksum = digest is not None or checked is not None
        if with_tensors and has_checksum and digest != _checksum(tensors, json.dumps(metadata)):
            raise ValueError("the checksum differs")
    except _REFUSALS as error:
        raise UserError(f"{path}: truncated or corrupt ({one_line(error)}); {advice}") from error
    version = metadata.get("format_version")
    if version is not None and version not in _VERSIONS:
        readable = f"{_VERSIONS[0]} to {_VERSIONS[-1]}"
        raise UserError(f"{path}: format version {str(version)[:40]}, this program reads {readable}")
    return tensors, metadata


def _checksum(tensors: dict[str, torch.Tensor], text: str) -> str:
    # As bytes: NumPy has not all types.
    named = {f"{n} {t.dtype} {tuple(t.shape)}": t for n, t in tensors.items()}
    flat = {name: tensor.detach().cpu().reshape(-1).view(torch.uint8) for name, tensor in named.items()}
    return checksum({name: values.numpy() for name, values in flat.items()}, text)


# What a file may declare, by the name that it uses.
_NAMES = "float16", "float32", "float64", "bool", "uint8", "int16", "int32", "int64"
_TYPES = {name: getattr(torch, name) for name in _NAMES}
# Higher levels take seconds for one percent.
_LEVEL = 6
# Bytes that a file may unpack to, whatever its size, and per byte of it; forests take some ten.
_ALWAYS, _PER_BYTE = 1 << 28, 64


def packed(tensors: dict[str, torch.Tensor]) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """The content of each tensor as bytes, uint8, and its type and shape, which JSON can hold."""
    kinds = {name: [str(t.dtype).removeprefix("torch."), list(t.shape)] for name, t in tensors.items()}
    found = {}
    for name, tensor in tensors.items():
        flat = tensor.detach().cpu().contiguous().reshape(-1)
        planes = flat.view(torch.uint8).reshape(-1, flat.element_size()).T.contiguous().numpy()
        content = bytearray(zlib.compress(planes.tobytes(), _LEVEL))
        found[name] = torch.from_numpy(np.frombuffer(content, np.uint8))
    return found, kinds


def unpacked(tensors: dict[str, torch.Tensor], kinds: object) -> dict[str, torch.Tensor]:
    """The tensors that `packed` made these of, from the type and shape of each, as read from a file.

    ValueError if a type or a shape is none, the content does not have it, or it takes too much memory;
    KeyError if there is no type and shape of a tensor.
    """
    if not isinstance(kinds, dict):
        raise ValueError("types and shapes of packed tensors are missing")
    found = {name: _kind(name, kinds[name]) for name in tensors}
    total = sum(kind.itemsize * math.prod(shape) for kind, shape in found.values())
    most = max(_ALWAYS, _PER_BYTE * sum(tensor.numel() for tensor in tensors.values()))
    if total > most:
        raise ValueError(f"packed tensors of {total:,} bytes; at most {most:,} are unpacked")
    return {name: _unpacked(name, tensor, *found[name]) for name, tensor in tensors.items()}


def _unpacked(name: str, content: torch.Tensor, kind: torch.dtype, shape: list[int]) -> torch.Tensor:
    if content.dtype != torch.uint8:
        raise ValueError(f"{name} is {content.dtype}, expected packed bytes")
    size = kind.itemsize * math.prod(shape)
    reader = zlib.decompressobj()
    try:
        # A byte more, since 0 would mean no limit.
        found = reader.decompress(content.reshape(-1).numpy().tobytes(), size + 1)
    except zlib.error as error:
        raise ValueError(f"{name} cannot be unpacked ({error})") from error
    if len(found) != size or not reader.eof:
        raise ValueError(f"{name} does not unpack to {size:,} bytes")
    planes = np.frombuffer(found, np.uint8).reshape(kind.itemsize, math.prod(shape))
    raw = torch.from_numpy(planes.T.copy()).reshape(-1)
    # Of other bytes than 0 and 1, torch does not make truth values.
    return (raw != 0 if kind == torch.bool else raw.view(kind)).reshape(shape)


def _kind(name: str, declared: object) -> tuple[torch.dtype, list[int]]:
    if not isinstance(declared, list) or len(declared) != 2:
        raise ValueError(f"{name} has no type and shape")
    kind, shape = declared
    right = isinstance(shape, list) and all(type(n) is int and 0 <= n < 2**40 for n in shape)
    if not isinstance(kind, str) or kind not in _TYPES or not right or len(shape) > 8:
        raise ValueError(f"{name} has a type or shape that does not exist")
    return _TYPES[kind], shape
