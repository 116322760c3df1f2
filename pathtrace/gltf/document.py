"""Reads .gltf and .glb files (specification, 3.6.1 and 4.4): their JSON, checked, and their buffers."""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from urllib.request import urlopen

import fastjsonschema
from trimesh.exchange.gltf import get_schema

from compose.base.errors import UserError, one_line
from compose.base.files import require_size_below
from compose.base.json_file import parse_json

# Integers as positions need no more than what accessors say.
EXTENSIONS = ("KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_mesh_quantization")
_MOST_BYTES = 1 << 31
_MAGIC, _JSON, _BINARY = b"glTF", 0x4E4F534A, 0x004E4942


@dataclass(frozen=True)
class Document:
    """A glTF file.

    Attributes:
        file: that it was read from.
        tree: its JSON; what the specification has defaults for is there.
        buffers: the bytes of each.
    """

    file: Path
    tree: dict[str, Any]
    buffers: list[bytes]

    def section(self, name: str) -> list[dict[str, Any]]:
        """All nodes, meshes, accessors or the like."""
        found: list[dict[str, Any]] = self.tree.get(name, [])
        return found

    def item(self, name: str, index: int | float, user: str) -> dict[str, Any]:
        """One of a section; `user` is what refers to it, in error messages.

        Raises:
            UserError: there is none.
        """
        items = self.section(name)
        if not 0 <= index < len(items):
            raise self.refused(f"{user} refers to {name}[{index}]; there are {len(items)}")
        return items[int(index)]

    def refused(self, why: str) -> UserError:
        """What to raise for what is wrong in the file."""
        return UserError(f"{self.file}: {one_line(why)}")

    def resource(self, uri: str, user: str) -> bytes:
        """What a URI stands for: data of its own, or a file in the folder of the document.

        Raises:
            UserError: there is none, or it is elsewhere.
        """
        try:
            return _resource(self.file.parent, uri)
        except (OSError, ValueError) as error:
            raise self.refused(f"{user}: {uri[:80]!r} cannot be read ({one_line(error)})") from error


def read_document(file: Path) -> Document:
    """Reads a glTF 2.0 file and all of its buffers.

    Raises:
        UserError: it cannot be read, is no glTF 2.0, requires an extension that is not known here, or lacks
            a buffer.
    """
    try:
        require_size_below(file, _MOST_BYTES)
        text, binary = _parts(file.read_bytes())
        tree = parse_json(text.decode("utf-8-sig"))
    except (OSError, ValueError, struct.error) as error:
        raise UserError(f"{file}: cannot be read as glTF ({one_line(error)})") from error
    _require_version(file, tree)
    unknown = [name for name in tree.get("extensionsRequired", []) if name not in EXTENSIONS]
    if unknown:
        raise UserError(
            f"{file}: requires the extension {one_line(str(unknown[0]))}, which is not known here"
        )
    document = Document(file, _valid(file, _without_empty_lists(tree)), [])
    for number, buffer in enumerate(document.section("buffers")):
        document.buffers.append(_buffer(document, number, buffer, binary))
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


def _require_version(file: Path, tree: Any) -> None:
    asset = tree.get("asset") if isinstance(tree, dict) else None
    version = asset.get("version") if isinstance(asset, dict) else None
    if not isinstance(version, str) or version.split(".")[0] != "2":
        raise UserError(f"{file}: is no glTF 2.0; its asset.version is {one_line(repr(version))}")


def _without_empty_lists(tree: Any) -> Any:
    """What the specification forbids and exporters write nevertheless."""
    if isinstance(tree, dict):
        return {name: _without_empty_lists(value) for name, value in tree.items() if value != []}
    if isinstance(tree, list):
        return [_without_empty_lists(value) for value in tree]
    return tree


def _valid(file: Path, tree: Any) -> dict[str, Any]:
    """A tree that follows the schema of the specification, with its defaults."""
    try:
        return _schema()(tree)
    except fastjsonschema.JsonSchemaException as error:
        raise UserError(f"{file}: is no glTF 2.0; {one_line(error)}") from error


@functools.cache
def _schema() -> Callable[[Any], dict[str, Any]]:
    # A schema is compiled to Python; the specification's own comes with trimesh.
    return fastjsonschema.compile(get_schema())


def _buffer(document: Document, number: int, buffer: dict[str, Any], binary: bytes | None) -> bytes:
    uri, user = buffer.get("uri"), f"buffers[{number}]"
    if uri is not None:
        content = document.resource(uri, user)
    elif number == 0 and binary is not None:
        content = binary
    else:
        raise document.refused(f"{user} is missing: it has no uri, and the file has no binary chunk for it")
    if len(content) < buffer["byteLength"]:
        raise document.refused(f"{user} has {len(content):,} bytes of {buffer['byteLength']:,}")
    return content


def _resource(folder: Path, uri: str) -> bytes:
    if uri.startswith("data:"):
        with urlopen(uri) as data:
            return bytes(data.read())
    file = (folder / unquote(uri)).resolve()
    if not file.is_relative_to(folder.resolve()):
        raise ValueError("lies outside of the folder")
    require_size_below(file, _MOST_BYTES)
    return file.read_bytes()
