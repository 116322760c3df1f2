"""Tracks, which say where a shape or light is at a time from 0 to 1, and motion files, which hold them.

A motion file is JSON beside a scene:

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

import ast
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias, TypeGuard, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from compose.base.errors import UserError, one_line, reading
from compose.base.files import read_json
from compose.camera.camera import Array

_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": np.sin,
    "cos": np.cos,
    "exp": np.exp,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "min": np.minimum,
    "max": np.maximum,
}
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
}
_TWO_ARGUMENTS = {"min", "max"}
_NAMES = {"x", "y", "z", "t", "pi"}
# Longer ones are no closed formulas, and nest deeper than Python can follow.
_MOST_CHARACTERS = 1000
_MOST_BYTES = 1 << 24
_DEFAULT_SECONDS = 1.0

_Evaluation: TypeAlias = Callable[[dict[str, Any]], Any]
_Track = TypeVar("_Track")
_Point = tuple[float, float, float]


@dataclass(frozen=True)
class Formula:
    """Vertices that move by three expressions of their rest position x, y, z and the time t.

    All are in the coordinates of the scene's file and in Python's notation: numbers, + - * / **, parentheses,
    pi, and sin, cos, exp, sqrt, abs, min and max. ValueError if an expression holds anything else.
    """

    texts: tuple[str, str, str]

    def __post_init__(self) -> None:
        for text in self.texts:
            _function(text)

    def positions(self, rest: Array, time: float) -> Array:
        """Positions (N, 3) at a time of vertices (N, 3) at rest; ValueError if one is not finite."""
        values = {**dict(zip("xyz", rest.T, strict=True)), "t": time, "pi": np.pi}
        with np.errstate(all="ignore"):
            columns = [np.broadcast_to(_function(text)(values), len(rest)) for text in self.texts]
        found = np.stack(columns, axis=1).astype(np.float64)
        if not np.isfinite(found).all():
            raise ValueError(f"formula has no finite value for every vertex at t = {time:g}")
        return found


# Of a scene that plays, the same formulas are asked for many times a second.
@lru_cache
def _function(text: str) -> _Evaluation:
    if len(text) > _MOST_CHARACTERS:
        raise ValueError(f"formula of {len(text):,} characters; must have at most {_MOST_CHARACTERS:,}")
    try:
        node = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, RecursionError, MemoryError, ValueError) as error:
        raise ValueError(f"{text!r} is no formula") from error
    return _compiled(node)


def _compiled(node: ast.expr) -> _Evaluation:
    """The value of an expression as a function of those of names; ValueError if no formula may hold it."""
    match node:
        case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
            number = float(value)
            return lambda values: number
        case ast.Name(id=name) if name in _NAMES:
            return lambda values: values[name]
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            function, parts = _OPERATORS[type(op)], [operand]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            function, parts = _OPERATORS[type(op)], [left, right]
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in _FUNCTIONS:
            if len(args) != (2 if name in _TWO_ARGUMENTS else 1):
                raise ValueError(f"{name} has {len(args)} arguments in a formula")
            function, parts = _FUNCTIONS[name], args
        case _:
            raise ValueError(
                f"{ast.unparse(node)!r} in a formula; may hold {', '.join(sorted(_NAMES))}, "
                f"numbers, + - * / **, {', '.join(_FUNCTIONS)}"
            )
    inner = [_compiled(part) for part in parts]
    return lambda values: function(*(part(values) for part in inner))


@dataclass(frozen=True)
class Keyframe:
    """A rigid pose at a time from 0 to 1, as the way there from where the file has the shape."""

    time: float
    translate: _Point = (0.0, 0.0, 0.0)
    # Around the track's axis, any number, so that wheels turn more than once; translated after that.
    degrees: float = 0.0
    # Unit quaternion (w, x, y, z) in place of degrees.
    rotation: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class RigidTrack:
    """Rigid motion: translation and angle are linear between keyframes, and constant beyond them.

    There is at least one keyframe; all have quaternions, between which shapes turn the shorter way at a
    constant speed (Shoemake 1985), or none. The axis is a unit vector; `about` is a point on it, at rest.
    ValueError if keyframes are missing, out of order, or of both kinds.
    """

    keyframes: tuple[Keyframe, ...]
    axis: _Point = (0.0, 0.0, 1.0)
    about: _Point = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require_ordered([key.time for key in self.keyframes])
        if len({key.rotation is None for key in self.keyframes}) > 1:
            raise ValueError("must have rotation in all keyframes, or in none")

    def pose(self, time: float) -> Array:
        """(4, 4) rigid transform from rest to a time, in the coordinates of the scene's file."""
        times, about = [key.time for key in self.keyframes], np.array(self.about)
        shift = between(time, times, [key.translate for key in self.keyframes])
        pose = np.eye(4)
        pose[:3, :3] = rotation = self._rotation(time, times)
        pose[:3, 3] = about - rotation @ about + shift
        return pose

    def _rotation(self, time: float, times: Sequence[float]) -> Array:
        quaternions = [key.rotation for key in self.keyframes if key.rotation is not None]
        if quaternions:
            rotations = Rotation.from_quat(quaternions, scalar_first=True)
            if len(quaternions) == 1:
                return rotations.as_matrix()[0]
            return Slerp(times, rotations)(np.clip(time, times[0], times[-1])).as_matrix()
        turn = np.radians(np.interp(time, times, [key.degrees for key in self.keyframes]))
        x, y, z = self.axis
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        # Rodrigues' formula.
        return np.eye(3) + np.sin(turn) * cross + (1 - np.cos(turn)) * cross @ cross


@dataclass(frozen=True)
class MeshTrack:
    """Vertices that go linearly between two meshes or more, in equal times, in the order of the shape's."""

    files: tuple[Path, ...]


ShapeTrack = RigidTrack | Formula | MeshTrack


@dataclass(frozen=True)
class Brightness:
    """How bright a light is at a time, as a multiple of what the scene's file has."""

    time: float
    factor: _Point


@dataclass(frozen=True)
class LightTrack:
    """A light whose radiance is linear between keyframes, and constant beyond; ValueError as `RigidTrack`."""

    keyframes: tuple[Brightness, ...]

    def __post_init__(self) -> None:
        require_ordered([key.time for key in self.keyframes])

    def factor(self, time: float) -> Array:
        """(3,) factor of red, green and blue at a time."""
        return between(time, [key.time for key in self.keyframes], [key.factor for key in self.keyframes])


@dataclass(frozen=True)
class SceneMotion:
    """What moves in a scene while the time goes from 0 to 1, in so many seconds."""

    seconds: float
    shapes: dict[str, ShapeTrack]  # by the id of a shape, or of a light without a shape that has a place
    lights: dict[str, LightTrack]  # of radiance, by the id of a light, or of a shape that shines
    fingerprint: str  # hash of the file and of all meshes that it names


def between(time: float, times: Sequence[float], values: Sequence[Sequence[float]]) -> Array:
    """Values interpolated at a time, each component linearly."""
    return np.array([np.interp(time, times, column) for column in np.asarray(values, dtype=np.float64).T])


def require_ordered(times: Sequence[float]) -> None:
    """ValueError unless there are times, from 0 to 1, in ascending order."""
    if not times:
        raise ValueError("no keyframes")
    for time in times:
        if not 0 <= time <= 1:
            raise ValueError(f"a keyframe has t = {time:g}; must be from 0 to 1")
    if any(later <= earlier for earlier, later in pairwise(times)):
        raise ValueError("keyframes are out of order; t must ascend")


def read_motion(file: Path) -> SceneMotion:
    """The motion in a file; UserError if that, or a mesh in it, cannot be read, or it is no motion."""
    with reading(file):
        document = read_json(file, _MOST_BYTES)
        digest = hashlib.sha256(file.read_bytes())
    parts: list[Any] = [
        document.get(name, {}) if isinstance(document, dict) else None for name in ("shapes", "lights")
    ]
    if not all(isinstance(part, dict) for part in parts):
        raise UserError(f"{file}: is no motion; must be JSON with tracks by name under shapes or lights")
    if not any(parts):
        raise UserError(f"{file}: nothing moves; must have tracks under shapes or lights")
    seconds = document.get("seconds", _DEFAULT_SECONDS)
    if not _is_number(seconds) or seconds <= 0:
        raise UserError(f"{file}: seconds is {one_line(repr(seconds))}; must be a positive number")
    moved = _tracks(f"{file}: shapes", parts[0], lambda track: _shape_track(track, file.parent))
    shining = _tracks(f"{file}: lights", parts[1], _light_track)
    for track in moved.values():
        for mesh in track.files if isinstance(track, MeshTrack) else ():
            with reading(f"{file}: {mesh}"):
                digest.update(mesh.read_bytes())
    return SceneMotion(float(seconds), moved, shining, digest.hexdigest())


def _tracks(where: str, given: dict[str, Any], read: Callable[[dict[str, Any]], _Track]) -> dict[str, _Track]:
    found = {}
    for name, track in given.items():
        try:
            if not isinstance(track, dict):
                raise ValueError("is no track")
            found[name] = read(track)
        except (TypeError, ValueError, OverflowError) as error:
            raise UserError(f"{where}: {one_line(name)}: {one_line(error)}") from error
    return found


def _shape_track(track: dict[str, Any], folder: Path) -> ShapeTrack:
    kinds = [kind for kind in ("keyframes", "formula", "meshes") if kind in track]
    if len(kinds) != 1:
        raise ValueError("must have one of keyframes, formula and meshes")
    _require_known(track, {"keyframes", "axis", "about"} if kinds == ["keyframes"] else set(kinds))
    if kinds == ["formula"]:
        texts = track["formula"]
        if not _is_texts(texts) or len(texts) != 3:
            raise ValueError("formula must be three texts, of x, y and z")
        return Formula((texts[0], texts[1], texts[2]))
    if kinds == ["meshes"]:
        names = track["meshes"]
        if not _is_texts(names) or len(names) < 2:
            raise ValueError("meshes must be two files or more")
        files = [folder / name for name in names]
        if missing := [file for file in files if not file.is_file()]:
            raise ValueError(f"{missing[0]} does not exist")
        return MeshTrack(tuple(files))
    axis = np.array(_point(track, "axis", [0, 0, 1]))
    length = float(np.linalg.norm(axis))
    if not length:
        raise ValueError("axis has no length")
    x, y, z = (axis / length).tolist()
    keyframes = _each(track["keyframes"], _keyframe)
    return RigidTrack(keyframes, (x, y, z), _point(track, "about", [0, 0, 0]))


def _light_track(track: dict[str, Any]) -> LightTrack:
    _require_known(track, {"keyframes"})
    return LightTrack(_each(track.get("keyframes"), _brightness))


def _keyframe(key: dict[str, Any]) -> Keyframe:
    _require_known(key, {"t", "translate", "degrees", "rotation"})
    if "degrees" in key and "rotation" in key:
        raise ValueError("a keyframe has degrees and rotation; must have one of them")
    shift = _point(key, "translate", [0, 0, 0])
    found = Keyframe(_number(key, "t"), shift, _number(key, "degrees", 0.0))
    if "rotation" not in key:
        return found
    value = key["rotation"]
    if not _is_numbers(value, 4):
        raise ValueError(f"rotation is {value!r}; must be four numbers, w, x, y and z")
    length = float(np.linalg.norm(value))
    if not 0.99 < length < 1.01:
        raise ValueError(f"rotation is {value!r}; must be a unit quaternion")
    w, x, y, z = (float(part) / length for part in value)
    return replace(found, rotation=(w, x, y, z))


def _brightness(key: dict[str, Any]) -> Brightness:
    _require_known(key, {"t", "factor"})
    factor = key.get("factor", 1.0)
    factors = _point({"factor": [factor] * 3 if _is_number(factor) else factor}, "factor", [1] * 3)
    if min(factors) < 0:
        raise ValueError("factor is negative")
    return Brightness(_number(key, "t"), factors)


def _each(keys: object, read: Callable[[dict[str, Any]], _Track]) -> tuple[_Track, ...]:
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


def _point(found: dict[str, Any], name: str, default: list[float]) -> _Point:
    value = found.get(name, default)
    if not _is_numbers(value, 3):
        raise ValueError(f"{name} is {value!r}; must be three numbers")
    return (float(value[0]), float(value[1]), float(value[2]))


def _is_texts(value: object) -> TypeGuard[list[str]]:
    return isinstance(value, list) and all(isinstance(text, str) for text in value)


def _is_numbers(value: object, count: int) -> TypeGuard[list[float]]:
    return isinstance(value, list) and len(value) == count and all(map(_is_number, value))


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))
