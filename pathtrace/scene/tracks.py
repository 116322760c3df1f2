"""Tracks: where a shape, or a light, is at a time from 0 to 1, by keyframes, meshes or a formula.

Formulas are closed ones: arithmetic of x, y, z and t, and nothing else.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

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


@dataclass(frozen=True)
class Formula:
    """Vertices that move by three expressions of their rest position x, y, z and the time t.

    All are in the coordinates of the scene's file.

    Attributes:
        texts: of the new x, y and z, in Python's notation: numbers, + - * / **, parentheses, pi, and sin,
            cos, exp, sqrt, abs, min and max.

    ValueError if an expression holds anything else.
    """

    texts: tuple[str, str, str]

    def __post_init__(self) -> None:
        for text in self.texts:
            _require_closed(_parsed(text))

    def positions(self, rest: Array, time: float) -> Array:
        """Positions (N, 3) at a time of vertices (N, 3) at rest; ValueError if one is not finite."""
        values = {**dict(zip("xyz", rest.T, strict=True)), "t": time, "pi": np.pi}
        with np.errstate(all="ignore"):
            columns = [np.broadcast_to(_value(_parsed(text), values), len(rest)) for text in self.texts]
        found = np.stack(columns, axis=1).astype(np.float64)
        if not np.isfinite(found).all():
            raise ValueError(f"formula has no finite value for every vertex at t = {time:g}")
        return found


# Of a scene that plays, the same formulas are asked for many times a second.
@lru_cache
def _parsed(text: str) -> ast.expr:
    if len(text) > _MOST_CHARACTERS:
        raise ValueError(f"formula of {len(text):,} characters; must have at most {_MOST_CHARACTERS:,}")
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, RecursionError, MemoryError, ValueError) as error:
        raise ValueError(f"{text!r} is no formula") from error


def _require_closed(node: ast.expr) -> None:
    """ValueError if an expression holds what a formula may not."""
    match node:
        case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
            return
        case ast.Name(id=name) if name in _NAMES:
            return
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            _require_closed(operand)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            _require_closed(left)
            _require_closed(right)
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in _FUNCTIONS:
            if len(args) != (2 if name in _TWO_ARGUMENTS else 1):
                raise ValueError(f"{name} has {len(args)} arguments in a formula")
            for argument in args:
                _require_closed(argument)
        case _:
            raise ValueError(
                f"{ast.unparse(node)!r} in a formula; may hold {', '.join(sorted(_NAMES))}, "
                f"numbers, + - * / **, {', '.join(_FUNCTIONS)}"
            )


def _value(node: ast.expr, values: dict[str, Any]) -> Any:
    match node:
        case ast.Constant(value=value):
            return float(value)  # type: ignore[arg-type]
        case ast.Name(id=name):
            return values[name]
        case ast.UnaryOp(op=op, operand=operand):
            return _OPERATORS[type(op)](_value(operand, values))
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATORS[type(op)](_value(left, values), _value(right, values))
        case ast.Call(func=ast.Name(id=name), args=args):
            return _FUNCTIONS[name](*(_value(argument, values) for argument in args))
    raise AssertionError("not checked")


@dataclass(frozen=True)
class Keyframe:
    """A rigid pose at a time from 0 to 1, as the way there from where the scene's file has the shape.

    After a rotation, it is translated. Degrees are those around the track's axis, any number, so that wheels
    turn more than once; a unit quaternion (w, x, y, z) stands for a rotation around any axis instead.
    """

    time: float
    translate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    degrees: float = 0.0
    rotation: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class RigidTrack:
    """Rigid motion: translation and angle are linear between keyframes, and constant beyond them.

    Between quaternions, shapes turn the shorter way at a constant speed (Shoemake 1985).

    Attributes:
        keyframes: at least one, in the order of their times; all have quaternions, or none.
        axis: (x, y, z), unit, that the shape turns around.
        about: (x, y, z), a point on the axis where the shape is at rest.

    ValueError if keyframes are missing or out of order, or some have quaternions and others do not.
    """

    keyframes: tuple[Keyframe, ...]
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    about: tuple[float, float, float] = (0.0, 0.0, 0.0)

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
        """(3, 3) at a time."""
        quaternions = [key.rotation for key in self.keyframes if key.rotation is not None]
        if len(quaternions) == 1:
            return _rotations(quaternions).as_matrix()[0]
        if quaternions:
            return Slerp(times, _rotations(quaternions))(np.clip(time, times[0], times[-1])).as_matrix()
        turn = np.radians(np.interp(time, times, [key.degrees for key in self.keyframes]))
        x, y, z = self.axis
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        # Rodrigues' formula.
        return np.eye(3) + np.sin(turn) * cross + (1 - np.cos(turn)) * cross @ cross


@dataclass(frozen=True)
class MeshTrack:
    """Vertices that go from mesh to mesh, linearly, in equal times from 0 to 1.

    There are at least two mesh files, whose vertices are in the coordinates of the scene's file, as many and
    in the same order as those of the shape.
    """

    files: tuple[Path, ...]


ShapeTrack = RigidTrack | Formula | MeshTrack


@dataclass(frozen=True)
class Brightness:
    """How bright a light is at a time, as a multiple of what the scene's file has."""

    time: float
    factor: tuple[float, float, float]


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
    """What moves in a scene while the time goes from 0 to 1, in so many seconds.

    Shapes have tracks by their id, or by that of a light that is no shape and has a place; lights have tracks
    of radiance by their id, or by that of the shape that shines. The fingerprint is a hash of the file and of
    all meshes that it names.
    """

    seconds: float
    shapes: dict[str, ShapeTrack]
    lights: dict[str, LightTrack]
    fingerprint: str


def _rotations(quaternions: Sequence[Sequence[float]]) -> Rotation:
    """Rotations from quaternions (w, x, y, z)."""
    return Rotation.from_quat(np.asarray(quaternions)[:, [1, 2, 3, 0]])


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
