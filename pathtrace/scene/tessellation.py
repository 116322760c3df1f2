"""Triangles of Mitsuba's shapes, meshes and analytic ones alike."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SPHERE_RINGS = 24
_CIRCLE_STEPS = 48


def triangles_of(shape: Any) -> Array | None:
    """(M, 3, 3) corners of a Mitsuba shape's triangles in world space; None if unsupported."""
    parameters = mi.traverse(shape)
    if "vertex_positions" in parameters:
        vertices = np.array(parameters["vertex_positions"]).reshape(-1, 3)
        faces = np.array(parameters["faces"]).reshape(-1, 3)
        return vertices[faces].astype(np.float64)
    unit = _unit_shape(shape.class_name())
    if unit is None or "to_world" not in parameters:
        return None
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    vertices = unit[0] @ matrix[:3, :3].T + matrix[:3, 3]
    return vertices[unit[1]]


def _unit_shape(kind: str) -> tuple[Array, NDArray[np.int32]] | None:
    """Vertices (V, 3) and triangles (M, 3) of an analytic shape in its own coordinates."""
    turn = np.linspace(0, 2 * np.pi, _CIRCLE_STEPS + 1)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    zero, one = np.zeros((len(turn), 1)), np.ones((len(turn), 1))
    if kind == "Rectangle":
        corners = np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]], dtype=np.float64)
        return corners, _grid_triangles(2, 2)
    if kind == "Disk":
        rim = np.hstack([circle, zero])
        return np.concatenate([rim * 0, rim]), _grid_triangles(2, len(turn))
    if kind == "Cylinder":
        rim = np.hstack([circle, zero])
        return np.concatenate([rim, rim + np.hstack([zero, zero, one])]), _grid_triangles(2, len(turn))
    if kind == "Sphere":
        polar = np.linspace(0, np.pi, _SPHERE_RINGS)[:, None]
        ring = [np.sin(polar) * circle[:, 0], np.sin(polar) * circle[:, 1], np.cos(polar) + 0 * turn]
        return np.stack(ring, axis=-1).reshape(-1, 3), _grid_triangles(_SPHERE_RINGS, len(turn))
    return None


def _grid_triangles(rows: int, columns: int) -> NDArray[np.int32]:
    """(M, 3) vertex indices: two triangles per cell of a (rows x columns) grid of vertices."""
    corner = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, : columns - 1].ravel()
    lower = np.stack([corner, corner + 1, corner + columns], axis=1)
    upper = np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1)
    return np.concatenate([lower, upper]).astype(np.int32)
