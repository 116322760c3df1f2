"""The course of what moves rigidly, a shape or a piece of one, as poses in equal steps of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Course:
    """Where a shape, or a piece of one that deforms, is over time.

    Attributes:
        name: its id in the scene's file.
        shape: its index among the shapes of the scene, which frames have per pixel.
        rotations: (T, 4) unit quaternions (w, x, y, z) from rest, at T equal steps of time from 0 to 1.
        centre: (3,) a point of it at rest, in the coordinates of the frames' cameras.
        shifts: (T, 3) how far that point is from rest.
    """

    name: str
    shape: int
    rotations: Array
    centre: Array
    shifts: Array

    def as_json(self) -> dict[str, Any]:
        """In types that JSON has."""
        return {
            "name": self.name,
            "shape": self.shape,
            "centre": self.centre.tolist(),
            "rotations": self.rotations.tolist(),
            "shifts": self.shifts.tolist(),
        }


def course_of_poses(name: str, shape: int, poses: Array, centre: Array) -> Course:
    """A course from (T, 4, 4) rigid transforms from rest."""
    rotations = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    return Course(name, shape, rotations, centre, poses[:, :3, :3] @ centre + poses[:, :3, 3] - centre)


def course_from_json(content: dict[str, Any]) -> Course:
    """The course that `as_json` described.

    Raises:
        KeyError, TypeError, ValueError: it describes none.
    """
    rotations, centre, shifts = (
        np.asarray(content[name], dtype=np.float64) for name in ("rotations", "centre", "shifts")
    )
    steps = len(rotations)
    if steps < 2 or rotations.shape != (steps, 4) or centre.shape != (3,) or shifts.shape != (steps, 3):
        raise ValueError("poses of a course do not fit together")
    if not all(np.isfinite(part).all() for part in (rotations, centre, shifts)):
        raise ValueError("a course that is not finite")
    lengths = np.linalg.norm(rotations, axis=1, keepdims=True)
    if np.abs(lengths - 1).max() > 1e-3:
        raise ValueError("rotations of a course are not unit quaternions")
    return Course(str(content["name"]), int(content["shape"]), rotations / lengths, centre, shifts)
