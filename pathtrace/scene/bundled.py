"""The scenes that come with the project."""

from __future__ import annotations

from pathlib import Path

_REPOSITORY_SCENES = Path(__file__).resolve().parents[2] / "scenes"
_INSTALLED_SCENES = Path(__file__).resolve().parents[1] / "scenes"


def bundled_scenes() -> dict[str, Path]:
    """Names and files of the scenes that come with the project."""
    folder = _INSTALLED_SCENES if _INSTALLED_SCENES.is_dir() else _REPOSITORY_SCENES
    return {path.parent.name: path for path in sorted(folder.glob("*/*.xml"))}
