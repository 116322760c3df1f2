"""Reads a motion file: JSON beside a scene that says which of its shapes and lights move, and how.

    {"seconds": 4, "shapes": {
        "door": {"axis": [0, 0, 1], "about": [1, 0, 0], "keyframes": [
            {"t": 0}, {"t": 0.5, "degrees": 90}, {"t": 1, "degrees": 0, "translate": [0, 0, 0.1]}]},
        "flag": {"formula": ["x", "y + 0.1 * x * sin(2 * pi * (t + x))", "z"]},
        "cloth": {"meshes": ["cloth-0.ply", "cloth-1.ply", "cloth-2.ply"]}},
     "lights": {
        "lamp": {"keyframes": [{"t": 0, "factor": 1}, {"t": 1, "factor": [1, 0.5, 0.2]}]}}}

Shapes are named by their id in the scene; all numbers are in the coordinates of the scene's file.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from compose.base.errors import UserError, one_line, reading
from compose.base.files import read_json
from pathtrace.scene import tracks

_MOST_BYTES = 1 << 24
_DEFAULT_SECONDS = 1.0
_Track = TypeVar("_Track")


def read_motion(file: Path) -> tracks.SceneMotion:
    """The motion in a file; UserError if that, or a mesh in it, cannot be read, or it is no motion."""
    with reading(file):
        document = read_json(file, _MOST_BYTES)
        digest = hashlib.sha256(file.read_bytes())
    shapes, lights = _section(file, document, "shapes"), _section(file, document, "lights")
    if not shapes and not lights:
        raise UserError(f"{file}: nothing moves; must have tracks under shapes or lights")
    seconds = document.get("seconds", _DEFAULT_SECONDS)
    if not _is_number(seconds) or seconds <= 0:
        raise UserError(f"{file}: seconds is {one_line(repr(seconds))}; must be a positive number")
    moved = _tracks(file, "shapes", shapes, lambda track: _shape_track(track, file.parent))
    shining = _tracks(file, "lights", lights, _light_track)
    for track in moved.values():
        for mesh in track.files if isinstance(track, tracks.MeshTrack) else ():
            with reading(f"{file}: {mesh}"):
                digest.update(mesh.read_bytes())
    return tracks.SceneMotion(float(seconds), moved, shining, digest.hexdigest())


def _section(file: Path, document: Any, name: str) -> dict[str, Any]:
    section = document.get(name, {}) if isinstance(document, dict) else None
    if not isinstance(section, dict):
        raise UserError(f"{file}: is no motion; must be JSON with tracks by name under shapes or lights")
    return section


def _tracks(
    file: Path, section: str, given: dict[str, Any], read: Callable[[dict[str, Any]], _Track]
) -> dict[str, _Track]:
    found = {}
    for name, track in given.items():
        try:
            if not isinstance(track, dict):
                raise ValueError("is no track")
            found[name] = read(track)
        except (TypeError, ValueError, OverflowError) as error:
            raise UserError(f"{file}: {section}: {one_line(name)}: {one_line(error)}") from error
    return found


def _shape_track(track: dict[str, Any], folder: Path) -> tracks.ShapeTrack:
    kinds = [kind for kind in ("keyframes", "formula", "meshes") if kind in track]
    if len(kinds) != 1:
        raise ValueError("must have one of keyframes, formula and meshes")
    _require_known(track, {"keyframes", "axis", "about"} if kinds == ["keyframes"] else set(kinds))
    if "formula" in track:
        return _formula(track["formula"])
    if "meshes" in track:
        return tracks.MeshTrack(_meshes(track["meshes"], folder))
    axis = np.array(_point(track, "axis", [0, 0, 1]))
    length = float(np.linalg.norm(axis))
    if not length:
        raise ValueError("axis has no length")
    x, y, z = (axis / length).tolist()
    keyframes = _each(track["keyframes"], _keyframe)
    return tracks.RigidTrack(keyframes, (x, y, z), _point(track, "about", [0, 0, 0]))


def _light_track(track: dict[str, Any]) -> tracks.LightTrack:
    _require_known(track, {"keyframes"})
    return tracks.LightTrack(_each(track.get("keyframes"), _brightness))


def _keyframe(key: dict[str, Any]) -> tracks.Keyframe:
    _require_known(key, {"t", "translate", "degrees", "rotation"})
    if "degrees" in key and "rotation" in key:
        raise ValueError("a keyframe has degrees and rotation; must have one of them")
    rotation = _quaternion(key["rotation"]) if "rotation" in key else None
    shift = _point(key, "translate", [0, 0, 0])
    return tracks.Keyframe(_number(key, "t"), shift, _number(key, "degrees", 0.0), rotation)


def _quaternion(value: Any) -> tuple[float, float, float, float]:
    if not _is_numbers(value, 4):
        raise ValueError(f"rotation is {value!r}; must be four numbers, w, x, y and z")
    length = float(np.linalg.norm(value))
    if not 0.99 < length < 1.01:
        raise ValueError(f"rotation is {value!r}; must be a unit quaternion")
    w, x, y, z = (float(part) / length for part in value)
    return (w, x, y, z)


def _brightness(key: dict[str, Any]) -> tracks.Brightness:
    _require_known(key, {"t", "factor"})
    factor = key.get("factor", 1.0)
    red, green, blue = _point({"factor": [factor] * 3 if _is_number(factor) else factor}, "factor", [1] * 3)
    if min(red, green, blue) < 0:
        raise ValueError("factor is negative")
    return tracks.Brightness(_number(key, "t"), (red, green, blue))


def _formula(texts: Any) -> tracks.Formula:
    if not isinstance(texts, list) or len(texts) != 3 or not all(isinstance(text, str) for text in texts):
        raise ValueError("formula must be three texts, of x, y and z")
    return tracks.Formula((texts[0], texts[1], texts[2]))


def _meshes(names: Any, folder: Path) -> tuple[Path, ...]:
    if not isinstance(names, list) or len(names) < 2 or not all(isinstance(name, str) for name in names):
        raise ValueError("meshes must be two files or more")
    files = tuple(folder / name for name in names)
    for file in files:
        if not file.is_file():
            raise ValueError(f"{file} does not exist")
    return files


def _each(keys: Any, read: Callable[[dict[str, Any]], _Track]) -> tuple[_Track, ...]:
    if not isinstance(keys, list) or not all(isinstance(key, dict) for key in keys):
        raise ValueError("keyframes must be a list of objects")
    return tuple(read(key) for key in keys)


def _require_known(found: dict[str, Any], known: set[str]) -> None:
    """A misspelt name would be a motion that is silently left out."""
    if unknown := sorted(set(found) - known):
        raise ValueError(f"{unknown[0]} is unknown here; may have {', '.join(sorted(known))}")


def _number(found: dict[str, Any], name: str, default: float | None = None) -> float:
    value = found.get(name, default)
    if value is None or not _is_number(value):
        raise ValueError(f"{name} is {value!r}; must be a number")
    return float(value)


def _point(found: dict[str, Any], name: str, default: list[float]) -> tuple[float, float, float]:
    value = found.get(name, default)
    if not _is_numbers(value, 3):
        raise ValueError(f"{name} is {value!r}; must be three numbers")
    return (float(value[0]), float(value[1]), float(value[2]))


def _is_numbers(value: Any, count: int) -> bool:
    return isinstance(value, list) and len(value) == count and all(map(_is_number, value))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))
