"""Own coordinates of a set of Gaussians: where they lie in the world, and their unit of length.

The kernels compute in float32 and have a near plane. In coordinates whose origin lies amid what the training
views see and whose unit is a share of how far away that is, both are as good for a room of a tenth of a
millimetre, or a million rooms away from the world's origin, as for a room of four metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from compose.camera.camera import Camera
from splat.model.gaussians import Gaussians

# Seen by the training views, the scene lies this many units away, as a room does in metres.
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
        if not np.all(np.isfinite([*self.origin, self.unit])) or self.unit <= 0 or len(self.origin) != 3:
            raise ValueError(f"origin {self.origin}, unit {self.unit}: must be finite, the unit positive")

    @staticmethod
    def around(points: NDArray[np.floating], distance: float) -> Place:
        """The place of a scene from points (N, 3) that are seen, and the typical distance that they have."""
        middle = np.median(np.asarray(points, dtype=np.float64), axis=0)
        return Place((float(middle[0]), float(middle[1]), float(middle[2])), distance / TYPICAL_DISTANCE)

    def camera(self, world: Camera) -> Camera:
        """A camera of the world in these coordinates; computed in float64."""
        pose = np.array(world.world_to_camera, dtype=np.float64)
        pose[:3, 3] = (pose[:3, 3] + pose[:3, :3] @ np.array(self.origin)) / self.unit
        return replace(world, world_to_camera=pose)

    def in_world(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """World positions (N, 3) of points (N, 3) of these coordinates."""
        return np.asarray(points, dtype=np.float64) * self.unit + np.array(self.origin)

    def gaussians_in_world(self, own: Gaussians) -> Gaussians:
        """The Gaussians in world space: as exact as float32 is there."""
        return _mapped(own, np.array(self.origin), self.unit)

    def gaussians_from_world(self, world: Gaussians) -> Gaussians:
        """Gaussians of the world in these coordinates."""
        return _mapped(world, -np.array(self.origin) / self.unit, 1 / self.unit)


# Coordinates that are those of the world.
WORLD = Place()


def _mapped(gaussians: Gaussians, offset: NDArray[np.float64], scale: float) -> Gaussians:
    """The Gaussians scaled, then moved; computed in float64."""
    means = gaussians.means.double() * scale + torch.from_numpy(offset)[:, None]
    log_scales = gaussians.log_scales.double() + float(np.log(scale))
    return replace(gaussians, means=means.float(), log_scales=log_scales.float())
