"""A scene's XML file, checked and prepared for Mitsuba: what its elements refer to, and its fingerprint.

Nothing in it makes a parser take unbounded memory or stack, or loads code that is not Mitsuba's.
"""

from __future__ import annotations

import hashlib
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from compose.base.errors import UserError, one_line, reading
from compose.base.files import require_size_below
from pathtrace.scene.sunsky import balance_xml

# Scenes with thousands of shapes have some megabytes of XML, nested ten deep.
_MOST_BYTES = 1 << 28
_DEEPEST = 100
# Mitsuba's limit, below which a loop of includes ends.
_DEEPEST_INCLUDE = 15
# Files that include each other twice are 2^15 by then.
_MOST_INCLUDES = 1000
# Of an attribute once its parameters are replaced: parameters of parameters grow exponentially.
_LONGEST = 1 << 16
_MOST_HASHED_BYTES = 1 << 36


def parse_xml(path: Path, content: bytes | None = None) -> ET.Element:
    """The top element of an XML file, or of content that is to lie there.

    UserError if it cannot be read, is too large, not well-formed or nested too deeply, or declares entities,
    which can stand for any amount of text.
    """
    if content is None:
        content = _content(path)
    # In UTF-16, each character has a zero byte.
    if b"<!ENTITY" in content.replace(b"\0", b""):
        raise UserError(f"{path}: declares XML entities; write out what they stand for")
    try:
        root = ET.fromstring(content)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise UserError(f"{path}: not well-formed XML: {one_line(error)}") from error
    level, depth = [root], 1
    while level:
        if depth > _DEEPEST:
            raise UserError(f"{path}: elements are nested more than {_DEEPEST} deep")
        level, depth = [child for element in level for child in element], depth + 1
    return root


def _content(path: Path) -> bytes:
    with reading(path):
        require_size_below(path, _MOST_BYTES)
        return path.read_bytes()


class References:
    """What the XML of a scene, and of the files that it includes, refers to.

    These are names of files in their order, with the folder of the XML that names them; folders of `<path>`,
    in which Mitsuba looks for them as well; types of all elements; and the path depth that the last
    integrator asks for, and whether one hides lights. The scene's own integrators count for nothing else
    unless asked for.

    UserError if an included file is not well-formed, includes are too many, or parameters stand for too much
    text.
    """

    def __init__(self, source: Path, root: ET.Element, with_integrator: bool = False):
        self.source, self._with_integrator = source, with_integrator
        self.names: list[tuple[str, Path]] = []
        self.folders: list[Path] = []
        self.plugins: set[str] = set()
        self.max_depth = ""
        self.hides_emitters = False
        self._parameters: dict[str, str] = {}
        self._includes = 0
        self._collect(root, source.parent, 0)

    def candidates(self, name: str, beside: Path) -> Iterator[Path]:
        """Files that a name in a file of a folder may stand for, in the order of folders to search."""
        folders = list(dict.fromkeys([*self.folders, beside, self.source.parent]))
        # Of names that no file can have, pathlib's own function raises an error.
        files = [folder / name for folder in folders if os.path.isfile(folder / name)]
        return iter(files or ([Path(name)] if os.path.isfile(name) else []))

    def _collect(self, root: ET.Element, folder: Path, depth: int) -> None:
        """Walks through a file in the order of its elements, in which parameters are defined."""
        of_integrators = {part for one in root.findall("integrator") for part in one.iter()}
        for element in root.iter():
            values = {self._replaced(key): self._replaced(value) for key, value in element.items()}
            value = values.get("value", "")
            if element in of_integrators:
                asked = element.tag, values.get("name")
                self.max_depth = value.strip() if asked == ("integer", "max_depth") else self.max_depth
                hides = asked == ("boolean", "hide_emitters") and value.strip().lower() == "true"
                self.hides_emitters |= hides
                if not (depth or self._with_integrator):
                    continue
            self.plugins.update({values["type"]} if "type" in values else ())
            if element.tag == "default":
                # Mitsuba keeps the first definition.
                self._parameters.setdefault(values.get("name", ""), value)
            elif element.tag == "path" and value:
                self.folders += [self.source.parent / value, folder / value]
            elif element.tag == "include":
                self._include(values.get("filename", ""), folder, depth)
            elif element.tag == "string" and values.get("name") == "filename":
                self.names.append((value, folder))
            elif "filename" in values:
                self.names.append((values["filename"], folder))

    def _include(self, name: str, folder: Path, depth: int) -> None:
        self._includes += 1
        if depth >= _DEEPEST_INCLUDE or self._includes > _MOST_INCLUDES:
            limits = f"{_DEEPEST_INCLUDE} deep, {_MOST_INCLUDES} in all"
            raise UserError(
                f"{self.source}: includes {name[:80]!r} too often, or in a loop; at most {limits}"
            )
        self.names.append((name, folder))
        for file in self.candidates(name, folder):
            self._collect(parse_xml(file), file.parent, depth + 1)

    def _replaced(self, text: str) -> str:
        """A text with `$` parameters replaced, the longest names first."""
        if "$" not in text:
            return text
        for name in sorted(self._parameters, key=len, reverse=True):
            value, times = self._parameters[name], text.count(f"${name}")
            if len(text) + times * len(value) > _LONGEST:
                raise UserError(f"{self.source}: parameters stand for more than {_LONGEST:,} characters")
            text = text.replace(f"${name}", value)
        return text


def mitsuba_folder() -> Path:
    """The folder of Mitsuba's own plugins and data."""
    return Path(mi.__file__).parent


def require_own_plugins(source: Path, types: Iterable[str], folders: Iterable[Path]) -> None:
    """UserError if a plugin of these types would be loaded from one of the folders, not Mitsuba's own."""
    own = {path.stem for path in (mitsuba_folder() / "plugins").iterdir()}
    searched = [folder / "plugins" for folder in (*folders, Path())]
    found = {path.stem for folder in searched if folder.is_dir() for path in folder.iterdir()}
    for kind in sorted(types):
        if set("/\\$\0") & set(kind) or (kind not in own and kind in found):
            raise UserError(
                f"{source}: type {kind[:80]!r} is no plugin of Mitsuba; a scene may not bring its own code"
            )


def referenced_files(path: Path) -> list[Path]:
    """A scene's XML file and all that Mitsuba loads because of it; UserError if it is not well-formed."""
    references = References(path, parse_xml(path))
    found = [file for name, beside in references.names for file in references.candidates(name, beside)]
    return list(dict.fromkeys([path, *found]))


def file_fingerprint(content: bytes, root: ET.Element, references: References) -> str:
    """Hash (64 hexadecimal digits) of a scene's XML and of every file that Mitsuba loads because of it.

    Files that only includes, search folders or parameters lead to are added with their sizes.
    """
    digest, folder = hashlib.sha256(content), references.source.parent
    named = (e for e in root.iter("string") if e.get("name") == "filename")
    direct = [file for e in named if os.path.isfile(file := folder / (e.get("value") or ""))]
    for file in direct:
        _add(digest, file)
    for number, (name, beside) in enumerate(references.names):
        for file in references.candidates(name, beside):
            if file not in direct:
                digest.update(f"{number} {file.stat().st_size}\0".encode())
                _add(digest, file)
    return digest.hexdigest()


def _add(digest: hashlib._Hash, file: Path) -> None:
    with reading(file):
        left = require_size_below(file, _MOST_HASHED_BYTES)
        with file.open("rb") as opened:
            # No more than its size: some files of the system never end.
            while left > 0 and (block := opened.read(min(left, 1 << 20))):
                digest.update(block)
                left -= len(block)


def text_fingerprint(text: str) -> str:
    """Hash of a text: a fingerprint and what it does not cover."""
    return hashlib.sha256(text.encode()).hexdigest()


def dictionary_fingerprint(scene: dict[str, Any]) -> str:
    """Hash of a scene dictionary, its printed form, and of the files and the objects that it holds."""
    digest = hashlib.sha256(repr(scene).encode())
    _add_held(digest, scene)
    return digest.hexdigest()


def _add_held(digest: hashlib._Hash, value: object) -> None:
    if isinstance(value, dict):
        for key, part in value.items():
            file = Path(part) if key == "filename" and isinstance(part, str) else None
            if file is not None and os.path.isfile(file):
                _add(digest, file)
            _add_held(digest, part)
    elif isinstance(value, mi.Bitmap | np.ndarray) or dr.is_array_v(value):
        values = np.asarray(value)
        digest.update(f"{values.dtype} {values.shape}\0".encode() + values.tobytes())
    elif isinstance(value, mi.Object):
        for _, part in mi.traverse(value):
            _add_held(digest, part)


@dataclass(frozen=True)
class SceneDescription:
    """A scene's XML, hash of all files, path depth (-1 without bound), and whether lights are hidden."""

    text: str
    fingerprint: str
    max_depth: int
    hides_emitters: bool


def read_description(path: Path, given: str | None = None, with_integrator: bool = False) -> SceneDescription:
    """Reads a scene's XML file, or a text that is to lie there, without its integrator by default.

    Scenes may name integrators that only their author has. UserError if the file is not well-formed, might
    take unbounded memory, or would load native code that is not Mitsuba's.
    """
    content = _content(path) if given is None else given.encode()
    root = parse_xml(path, content)
    references = References(path, root, with_integrator)
    if not with_integrator:
        for element in root.findall("integrator"):
            root.remove(element)
    require_own_plugins(path, references.plugins, [path.parent, *references.folders])
    fingerprint = file_fingerprint(content, root, references)
    # Mitsuba would look for them from the working folder.
    for element in root.iter("path"):
        if (found := path.parent / element.get("value", "")).is_dir():
            element.set("value", str(found))
    balance_xml(root)
    text, asked = ET.tostring(root, encoding="unicode"), references.max_depth
    # Mitsuba's "no limit" is -1; longer numbers are none, either.
    depth = int(asked) if re.fullmatch(r"\d{1,9}", asked) and int(asked) else -1
    return SceneDescription(text, fingerprint, depth, references.hides_emitters)
