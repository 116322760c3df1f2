"""What a scene's XML refers to: plugins, and files, by way of includes, search folders and parameters."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from compose.base.errors import UserError
from pathtrace.scene.xml import parse_xml

# Mitsuba's limit, below which a loop of includes ends.
_DEEPEST_INCLUDE = 15
# Files that include each other twice are 2^15 by then.
_MOST_INCLUDES = 1000
# Of an attribute once its parameters are replaced: parameters of parameters grow exponentially.
_LONGEST = 1 << 16


@dataclass
class References:
    """What the XML of a scene, and of the files that it includes, refers to.

    Attributes:
        source: the scene's XML file.
        names: of files in the order of the XML, parameters replaced; whether they exist is not known.
        folders: in which Mitsuba looks for them, besides the scene's: those of `<path>`.
        plugins: types of all elements.
    """

    source: Path
    names: list[str] = field(default_factory=list)
    folders: list[Path] = field(default_factory=list)
    plugins: set[str] = field(default_factory=set)
    _parameters: dict[str, str] = field(default_factory=dict)
    _includes: int = 0

    @staticmethod
    def of(source: Path, root: ET.Element) -> References:
        """The references of a scene.

        Args:
            source: its XML file.
            root: its elements.

        Raises:
            UserError: an included file is not well-formed, includes form a loop or are too many, or
                parameters stand for too much text.
        """
        found = References(source)
        found._collect(root, source.parent, 0)
        return found

    def candidates(self, name: str) -> Iterator[Path]:
        """Files that a name may stand for: those in the search folders, else that in the working folder."""
        folders = [*self.folders, self.source.parent]
        files = [folder / name for folder in folders if is_file(folder / name)]
        return iter(files or ([Path(name)] if is_file(Path(name)) else []))

    def _collect(self, root: ET.Element, folder: Path, depth: int) -> None:
        """Walks through a file in the order of its elements, in which parameters are defined."""
        for element in root.iter():
            values = {self._replaced(key): self._replaced(value) for key, value in element.items()}
            self.plugins.update({values["type"]} if "type" in values else ())
            value = values.get("value", "")
            if element.tag == "default":
                # Mitsuba keeps the first definition.
                self._parameters.setdefault(values.get("name", ""), value)
            elif element.tag == "path" and value:
                self.folders += [self.source.parent / value, folder / value]
            elif element.tag == "include":
                self._include(values.get("filename", ""), depth)
            elif element.tag == "string" and values.get("name") == "filename":
                self.names.append(value)
            elif "filename" in values:
                self.names.append(values["filename"])

    def _include(self, name: str, depth: int) -> None:
        self._includes += 1
        if depth >= _DEEPEST_INCLUDE or self._includes > _MOST_INCLUDES:
            limits = f"{_DEEPEST_INCLUDE} deep, {_MOST_INCLUDES} in all"
            raise UserError(
                f"{self.source}: includes {name[:80]!r} too often, or in a loop; at most {limits}"
            )
        self.names.append(name)
        for file in self.candidates(name):
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


def is_file(path: Path) -> bool:
    """Whether a file exists; also for names that no file can have, such as those that are too long."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
