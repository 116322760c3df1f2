"""Reads .gltf and .glb files: their JSON, checked, their buffers, and the arrays of numbers in these.

Specification, 3.6.1, 3.6.2 and 4.4.
"""

from __future__ import annotations

import functools
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from urllib.request import urlopen

import fastjsonschema
import numpy as np
from numpy.typing import NDArray
from trimesh.exchange.gltf import get_schema

from compose.base.errors import UserError, one_line
from compose.base.files import parse_json, require_size_below
from compose.camera.camera import Array

GAUSSIANS = "KHR_gaussian_splatting"
# Integers as positions need no more than what accessors say.
EXTENSIONS = ("KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_mesh_quantization", GAUSSIANS)
_MOST_BYTES = 1 << 31
_MAGIC, _JSON, _BINARY = b"glTF", 0x4E4F534A, 0x004E4942
# Of accessors.
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
# An accessor that is all zeros can be declared without any data.
_MOST_NUMBERS = 1 << 28


class NotFiniteError(UserError):
    """Numbers in a file are NaN or infinite."""


@dataclass(frozen=True)
class Document:
    """A glTF file: its JSON, with the defaults of the specification, and the bytes of each buffer."""

    file: Path
    tree: dict[str, Any]
    buffers: list[bytes]

    def section(self, name: str) -> list[dict[str, Any]]:
        """All nodes, meshes, accessors or the like."""
        found: list[dict[str, Any]] = self.tree.get(name, [])
        return found

    def item(self, name: str, index: int | float, user: str) -> dict[str, Any]:
        """An item of a section, to which `user` refers, in error messages; UserError if there is none."""
        items = self.section(name)
        if not 0 <= index < len(items):
            raise self.refused(f"{user} refers to {name}[{index}]; there are {len(items)}")
        return items[int(index)]

    def refused(self, why: str, kind: type[UserError] = UserError) -> UserError:
        """What to raise for what is wrong in the file."""
        return kind(f"{self.file}: {one_line(why)}")

    def resource(self, uri: str, user: str) -> bytes:
        """What a URI stands for: its own data, or a file in the document's folder; UserError for others."""
        folder = self.file.parent.absolute()
        try:
            if uri.startswith("data:"):
                with urlopen(uri) as data:
                    return bytes(data.read())
            # By its name: stores of data sets have links where files should be.
            file = Path(os.path.normpath(folder / unquote(uri)))
            if not file.is_relative_to(os.path.normpath(folder)):
                raise ValueError("lies outside of the folder")
            require_size_below(file, _MOST_BYTES)
            return file.read_bytes()
        except (OSError, ValueError) as error:
            raise self.refused(f"{user}: {uri[:80]!r} cannot be read ({one_line(error)})") from error


@contextmanager
def undamaged(file: Path) -> Iterator[None]:
    """Says of what goes wrong with a file's content, which the schema leaves open, that it is damaged."""
    try:
        yield
    except (TypeError, ValueError, KeyError, IndexError, AttributeError, OverflowError) as error:
        raise UserError(f"{file}: is damaged ({type(error).__name__}: {one_line(error)})") from error


def read_document(file: Path) -> Document:
    """Reads a glTF 2.0 file and its buffers; UserError if one cannot be read, or it needs what is unknown."""
    try:
        require_size_below(file, _MOST_BYTES)
        text, binary = _parts(file.read_bytes())
        tree = parse_json(text.decode("utf-8-sig"))
    except (OSError, ValueError, struct.error) as error:
        raise UserError(f"{file}: cannot be read as glTF ({one_line(error)})") from error
    with undamaged(file):
        asset = tree.get("asset") if isinstance(tree, dict) else None
        version = asset.get("version") if isinstance(asset, dict) else None
        if not isinstance(version, str) or version.split(".")[0] != "2":
            raise UserError(f"{file}: is no glTF 2.0; its asset.version is {one_line(repr(version))}")
        if unknown := [name for name in tree.get("extensionsRequired", []) if name not in EXTENSIONS]:
            raise UserError(
                f"{file}: requires the extension {one_line(str(unknown[0]))}, which is not known here"
            )
        try:
            document = Document(file, _schema()(_mended(tree)), [])
        except fastjsonschema.JsonSchemaException as error:
            raise UserError(f"{file}: is no glTF 2.0; {one_line(error)}") from error
        for number, buffer in enumerate(document.section("buffers")):
            user, size = f"buffers[{number}]", buffer["byteLength"]
            content = binary if "uri" not in buffer and number == 0 else None
            if "uri" in buffer:
                content = document.resource(buffer["uri"], user)
            if content is None:
                raise document.refused(
                    f"{user} is missing: it has no uri, and the file has no binary chunk for it"
                )
            if len(content) < size:
                raise document.refused(f"{user} has {len(content):,} bytes of {size:,}")
            document.buffers.append(content)
        return document


def _parts(content: bytes) -> tuple[bytes, bytes | None]:
    """JSON and binary chunk of a file; one that is no GLB is all JSON."""
    if not content.startswith(_MAGIC):
        return content, None
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise ValueError(f"version {version}; must be 2")
    if length > len(content):
        raise ValueError(f"{len(content):,} bytes of {length:,}")
    chunks: dict[int, bytes] = {}
    start = 12
    while start < length:
        size, kind = struct.unpack_from("<II", content, start)
        chunks.setdefault(kind, content[start + 8 : start + 8 + size])
        start += 8 + size
    if _JSON not in chunks:
        raise ValueError("has no JSON")
    return chunks[_JSON], chunks.get(_BINARY)


def _mended(tree: object) -> object:
    """A tree without forbidden things that exporters write: empty lists and animations, spaces in URIs."""
    if isinstance(tree, list):
        return [_mended(value) for value in tree]
    if not isinstance(tree, dict):
        return tree
    kept = {name: _mended(value) for name, value in tree.items()}
    if isinstance(animations := kept.get("animations"), list):
        kept["animations"] = [one for one in animations if not isinstance(one, dict) or "channels" in one]
    if isinstance(uri := kept.get("uri"), str) and not uri.startswith("data:"):
        kept["uri"] = uri.replace("\\", "/").replace(" ", "%20")
    return {name: value for name, value in kept.items() if value != []}


@functools.cache
def _schema() -> Callable[[Any], dict[str, Any]]:
    # A schema is compiled to Python; the specification's own comes with trimesh.
    return fastjsonschema.compile(get_schema())


def read_array(document: Document, index: int, columns: int | tuple[int, ...], user: str) -> Array:
    """The (N, columns) numbers of an accessor; integers that stand for fractions are these fractions.

    Columns are those that it must have, or may have; the user, in error messages, is what refers to it.
    UserError if there is none, it has other columns, or lies outside of its buffer; a NotFiniteError, which
    is one, if it holds NaN or infinity.
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
        # Elements in place of those that it is based on.
        sparse, values = accessor["sparse"], values.copy()
        changed, indices = int(sparse["count"]), sparse["indices"]
        form = _TYPES.get(indices["componentType"], "<u4")
        where = _viewed(document, indices, form, (changed, 1), name)[:, 0].astype(np.int64)
        if where.min() < 0 or where.max() >= count:
            raise document.refused(f"{name} replaces elements that it does not have")
        values[where] = _viewed(document, sparse["values"], kind, (changed, found), name)
    numbers = values.astype(np.float64)
    if accessor.get("normalized") and values.dtype.kind != "f":
        # Integers as fractions of the largest one (3.6.2.2).
        numbers = np.maximum(numbers / float(np.iinfo(values.dtype).max), -1.0)
    if not np.isfinite(numbers).all():
        raise document.refused(f"{name} holds numbers that are not finite", NotFiniteError)
    return numbers


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
    content, stride = read_view(document, part["bufferView"], user)
    size = np.dtype(kind).itemsize
    start, row = int(part.get("byteOffset", 0)), int(stride or size * shape[1])
    if start + (shape[0] - 1) * row + size * shape[1] > len(content):
        raise document.refused(f"{user} ends beyond its buffer view")
    return np.ndarray(shape, kind, content, start, (row, size))
