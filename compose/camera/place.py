"""Own coordinates: where their origin lies in the world, and their unit of length.

Kernels compute in float32, with near planes and distances of their own. In coordinates whose origin lies amid
what is seen, and whose unit is a share of how far away that is, they are as exact in a room of a tenth of a
millimetre, or a million rooms away from the world's origin, as in a room of four metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera

# Seen from its views, a scene lies about this many units away, as a room does in metres.
TYPICAL_DISTANCE = 4.0


@dataclass(frozen=True)
class Place:
    """Own coordinates: a point p of them lies at origin + unit * p in the world.

    Attributes:
        origin: in world space, float64.
        unit: length of one unit in world space.

    Raises:
        ValueError: a number is not finite, or the unit not positive.
    """

    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: float = 1.0

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([*self.origin, self.unit])) or self.unit <= 0:
            raise ValueError(f"origin {self.origin}, unit {self.unit}: must be finite, the unit positive")

    def camera(self, world: Camera) -> Camera:
        """A camera of the world in these coordinates; computed in float64."""
        pose = np.array(world.world_to_camera, dtype=np.float64)
        pose[:3, 3] = (pose[:3, 3] + pose[:3, :3] @ np.array(self.origin)) / self.unit
        return replace(world, world_to_camera=pose)

    def in_world(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """World positions (N, 3) of points (N, 3) of these coordinates."""
        return np.asarray(points, dtype=np.float64) * self.unit + np.array(self.origin)


# Coordinates that are those of the world.
WORLD = Place()


def place_around(points: NDArray[np.floating], distance: float) -> Place:
    """The place of a scene from points (N, 3) that are seen, and the typical distance that they have."""
    x, y, z = np.median(np.asarray(points, dtype=np.float64), axis=0).tolist()
    return Place((x, y, z), distance / TYPICAL_DISTANCE)
