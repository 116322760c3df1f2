"""Files of scenes: the bundled ones by name, others by path."""

from __future__ import annotations

from pathlib import Path

from compose.base.errors import UserError

_REPOSITORY_SCENES = Path(__file__).resolve().parents[2] / "scenes"
_INSTALLED_SCENES = Path(__file__).resolve().parents[1] / "scenes"


def bundled_scenes() -> dict[str, Path]:
    """Names and files of the scenes that come with the project."""
    folder = _INSTALLED_SCENES if _INSTALLED_SCENES.is_dir() else _REPOSITORY_SCENES
    return {path.parent.name: path for path in sorted(folder.glob("*/*.xml"))}


def scene_file(source: str | Path) -> Path:
    """The XML file of a scene.

    Args:
        source: a bundled scene's name, the path of an XML file, or of a folder with a scene.xml.

    Raises:
        UserError: there is no such scene.
    """
    bundled = bundled_scenes()
    if str(source) in bundled:
        return bundled[str(source)]
    path = Path(source)
    if path.is_dir():
        path = path / "scene.xml"
    if not path.is_file():
        raise UserError(f"{source}: no such scene; name one of {', '.join(bundled)} or a Mitsuba XML file")
    return path.resolve()
