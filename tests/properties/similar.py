"""The same scene elsewhere, turned, larger or under stronger lights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np
import torch
from numpy.typing import NDArray

from compose.camera.camera import Camera, camera_from_pose
from splat.model.forest import Forest
from splat.model.gaussians import SH_DC, Gaussians, perceptual_from_radiance
from tests.properties.random_scenes import random_rotation
from tests.splat.raster import reference


@dataclass(frozen=True)
class Similarity:
    """x to scale * rotation x + translation.

    Attributes:
        rotation: (3, 3).
        translation: (3,).
        scale: above 0.
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    scale: float = 1.0

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.scale * self.rotation, self.translation
        return matrix

    def pose(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """(4, 4) a rigid pose moved along; it keeps its unit axes."""
        moved = self.matrix @ pose
        moved[:3, :3] = self.rotation @ pose[:3, :3]
        return moved

    def camera(self, camera: Camera) -> Camera:
        """The camera moved along."""
        intrinsics = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
        return camera_from_pose(self.pose(camera.camera_to_world), *intrinsics)

    def gaussians(self, gaussians: Gaussians) -> Gaussians:
        """Gaussians of degree 0 or 1 moved along, rounded to float32 once."""
        g, turn = reference.double(gaussians), torch.from_numpy(self.rotation)
        means = self.scale * turn @ g.means + torch.from_numpy(self.translation)[:, None]
        sh = g.sh.clone()
        if g.degree == 1:
            # The three harmonics are -y, z and -x times one factor: a vector.
            vector = torch.stack([-sh[3], -sh[1], sh[2]])
            x, y, z = torch.einsum("ij,jcn->icn", turn, vector)
            sh[1:] = torch.stack([-y, z, -x])
        values = means, g.log_scales + np.log(self.scale), self._turned(g.rotations), g.opacity_logits, sh
        return Gaussians(*(value.float() for value in values))

    def forest(self, forest: Forest) -> Forest:
        """A forest moved along; it fits any scene."""
        nodes = replace(forest.nodes, gaussians=self.gaussians(forest.nodes.gaussians))
        return replace(forest, nodes=nodes, scene_name="", scene_hash="")

    def scene(self, description: dict[str, Any]) -> dict[str, Any]:
        """The dictionary of a Mitsuba scene of rectangles, spheres and one sensor, moved along."""
        return {
            name: self._part(part) if isinstance(part, dict) else part for name, part in description.items()
        }

    def _part(self, part: dict[str, Any]) -> dict[str, Any]:
        placed = dict(part)
        to_world = part.get("to_world", mi.ScalarTransform4f())
        if part["type"] == "sphere":
            to_world = to_world.translate(placed.pop("center", [0, 0, 0])).scale(placed.pop("radius"))
        matrix = np.array(to_world.matrix, dtype=np.float64)
        matrix = self.pose(matrix) if part["type"] == "perspective" else self.matrix @ matrix
        return placed | {"to_world": mi.ScalarTransform4f(matrix)}

    def _turned(self, q: torch.Tensor) -> torch.Tensor:
        """(4, N) quaternions after this rotation."""
        a, b, c, d = _quaternion(self.rotation)
        w, x, y, z = q
        return torch.stack(
            [
                a * w - b * x - c * y - d * z,
                a * x + b * w + c * z - d * y,
                a * y - b * z + c * w + d * x,
                a * z + b * y - c * x + d * w,
            ]
        )


def random_motion(seed: int, reach: float = 1.0) -> Similarity:
    """A rigid motion by up to `reach` along each axis."""
    rng = np.random.default_rng(seed)
    return Similarity(random_rotation(rng), rng.uniform(-reach, reach, 3))


def scaling(scale: float) -> Similarity:
    """About the origin."""
    return Similarity(np.eye(3), np.zeros(3), scale)


def brighter(description: dict[str, Any], factor: float) -> dict[str, Any]:
    """The scene with the radiance of all its area lights, given in RGB, multiplied."""
    found = {}
    for name, part in description.items():
        found[name] = part
        if isinstance(part, dict) and "emitter" in part:
            emitter = part["emitter"]
            value = np.broadcast_to(emitter["radiance"]["value"], 3) * factor
            found[name] = part | {"emitter": emitter | {"radiance": {"type": "rgb", "value": value.tolist()}}}
    return found


def brighter_gaussians(gaussians: Gaussians, factor: float) -> Gaussians:
    """Gaussians of degree 0 whose radiance is multiplied: their harmonics are on the perceptual scale."""
    g = reference.double(gaussians)
    radiance = reference.radiance(0.5 + SH_DC * g.sh)
    sh = (perceptual_from_radiance(radiance * factor) - 0.5) / SH_DC
    return replace(gaussians, sh=sh.float())


def _quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """(w, x, y, z) of a rotation matrix, accurate for any angle (Bar-Itzhack 2000)."""
    r = rotation
    # It is the eigenvector of the largest eigenvalue; only the lower triangle is read.
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r.trace()],
        ]
    )
    x, y, z, w = np.linalg.eigh(k / 3)[1][:, -1]
    return np.array([w, x, y, z])
