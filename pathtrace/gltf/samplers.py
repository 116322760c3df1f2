"""Interpolation of what is animated (specification, appendix C)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sampler:
    """Values over time; before the first keyframe and after the last one, they are those of it.

    Attributes:
        times: (K,) of the keyframes in seconds, ascending.
        values: (K, C); (K, 3, C) of cubic splines: in-tangents, values and out-tangents.
        interpolation: LINEAR, STEP or CUBICSPLINE.
        is_rotation: whether values are quaternions (x, y, z, w), which turn at a constant speed.

    Raises:
        ValueError: times do not ascend, are negative, or are not as many as the values, or a quaternion has
            no length.
    """

    times: Array
    values: Array
    interpolation: str
    is_rotation: bool

    def __post_init__(self) -> None:
        if len(self.times) != len(self.values):
            raise ValueError(f"has {len(self.times)} times for {len(self.values)} values")
        if self.times[0] < 0 or (np.diff(self.times) <= 0).any():
            raise ValueError("has times that do not ascend from 0")
        if self.is_rotation and not np.linalg.norm(self._keys, axis=1).all():
            raise ValueError("has a quaternion without length")

    @property
    def _keys(self) -> Array:
        """(K, C) values at keyframes."""
        return self.values[:, 1] if self.interpolation == "CUBICSPLINE" else self.values

    def at(self, times: Array) -> Array:
        """(T, C) values at times (T,) in seconds."""
        inside = np.clip(times, self.times[0], self.times[-1])
        if self.interpolation == "STEP" or len(self.times) == 1:
            found = self._keys[np.searchsorted(self.times, inside, side="right") - 1]
        elif self.interpolation == "CUBICSPLINE":
            found = self._cubic(inside)
        elif self.is_rotation:
            return Slerp(self.times, Rotation.from_quat(self.values))(inside).as_quat()
        else:
            columns = [np.interp(inside, self.times, column) for column in self.values.T]
            found = np.stack(columns, axis=1)
        return _unit(found) if self.is_rotation else found

    def _cubic(self, times: Array) -> Array:
        """Cubic Hermite splines, whose tangents are per second (C.5)."""
        first = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        span = np.diff(self.times)[first, None]
        u = (times - self.times[first])[:, None] / span
        before, after = self.values[first], self.values[first + 1]
        return (
            (2 * u**3 - 3 * u**2 + 1) * before[:, 1]
            + span * (u**3 - 2 * u**2 + u) * before[:, 2]
            + (3 * u**2 - 2 * u**3) * after[:, 1]
            + span * (u**3 - u**2) * after[:, 0]
        )


def _unit(quaternions: Array) -> Array:
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.where(lengths > 0, quaternions / np.where(lengths > 0, lengths, 1), [0.0, 0.0, 0.0, 1.0])
