"""How well views that were trained on cover what a camera sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Array, Camera
from pathtrace.scene.triangles import Surfaces

_Indices = NDArray[np.int64]

# Frame in which coverage is looked up: 16 by 9 rays, or as many in other shapes.
_RAYS = 144
# Where nothing is seen, a point so far away, in distances between views, that only its direction counts.
_SKY = 1e5
# From a point back to a view, rays end this share of the way before the point: it lies on a surface.
_TOUCH = 1e-3
# Of what a camera sees, what is shown at half of its resolution or more is covered.
_LEAST = 0.5


class ViewCoverage:
    """What a set of views shows of a scene, and how finely.

    A view covers a point if that lies in its frame, nothing hides it, and pixels there are fine enough. All
    frames are compared at the height of the views'. Reflections do not count.
    """

    def __init__(self, surfaces: Surfaces, cameras: list[Camera]):
        self._surfaces = surfaces
        self._cameras: list[Camera] = []
        self.add(cameras)

    def add(self, cameras: list[Camera]) -> None:
        """Adds views."""
        self._cameras += cameras
        self._transforms = np.array([c.world_to_camera[:3] for c in self._cameras]).reshape(-1, 3, 4)
        self._positions = np.array([c.position for c in self._cameras]).reshape(-1, 3)
        numbers = [(c.width, c.height, c.fx, c.fy, c.cx, c.cy) for c in self._cameras]
        self._intrinsics = np.array(numbers, dtype=np.float64).reshape(-1, 6)

    def map(self, camera: Camera) -> Array:
        """(h, w), about 144 ratios of resolutions, from 0 (unseen) to 1, by which a frame is covered."""
        height = max(1, round(float(np.sqrt(_RAYS * camera.height / camera.width))))
        width = max(1, round(_RAYS / height))
        x, y = (
            (np.arange(n) + 0.5) * side / n for n, side in ((width, camera.width), (height, camera.height))
        )
        x, y = np.meshgrid(x, y)
        rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
        distance, normal = self._surfaces.hits(np.repeat(camera.position[None], len(rays), axis=0), rays)
        # A length that distances between camera, views and surfaces do not exceed by far.
        low, high = self._surfaces.bounds
        box = float(np.linalg.norm(high - low)) if np.isfinite(low).all() else 0.0
        spread = float(np.ptp(np.vstack([self._positions, camera.position]), axis=0).max())
        is_sky = ~np.isfinite(distance)
        distance[is_sky] = _SKY * max(spread, box, 1e-30)
        points = camera.position + rays * distance[:, None]
        normal[is_sky] = -rays[is_sky]
        wanted = _resolution(camera.fx, camera.fy, camera.height, camera.position - points, normal)
        view, point = self._pairs(points)
        _, heights, fx, fy, _, _ = self._intrinsics[view].T
        ways = self._positions[view] - points[point]
        shown = _resolution(fx, fy, heights, ways, normal[point])
        ratio = np.minimum(shown / np.maximum(wanted[point], 1e-300), 1)
        # Whether nothing hides points from views.
        length = np.linalg.norm(ways, axis=1)
        free = self._surfaces.distance(self._positions[view], -ways / length[:, None])
        is_visible = np.where(is_sky[point], np.isinf(free), free >= (1 - _TOUCH) * length)
        best = np.zeros(len(points))
        np.maximum.at(best, point, np.where(is_visible, ratio, 0))
        return best.reshape(height, width)

    def share(self, camera: Camera) -> float:
        """Share of a camera's frame, 0..1, that is covered at half of its resolution or more."""
        return float(np.mean(self.map(camera) >= _LEAST))

    def _pairs(self, points: Array) -> tuple[_Indices, _Indices]:
        """Index of the view and of the point wherever one of points (N, 3) lies in a view's frame."""
        local = np.einsum("vij,nj->vni", self._transforms[:, :, :3], points)
        local += self._transforms[:, None, :, 3]
        depth = local[:, :, 2]
        width, height, fx, fy, cx, cy = (column[:, None] for column in self._intrinsics.T)
        # Multiplied by the depth, which may be zero.
        x, y = fx * local[:, :, 0] + cx * depth, fy * local[:, :, 1] + cy * depth
        within = (depth > 0) & (x >= 0) & (y >= 0) & (x < width * depth) & (y < height * depth)
        view, point = np.nonzero(within)
        return view, point


def _resolution(
    fx: Array | float, fy: Array | float, height: Array | float, ways: Array, normal: Array
) -> Array:
    """(N,) frame heights per unit of length along surfaces with unit normals (N, 3), by ways to views (N, 3).

    At a slant, it is the geometric mean of both axes; from behind, 0.
    """
    length = np.linalg.norm(ways, axis=1)
    cosine = np.sum(ways * normal, axis=1) / length
    return np.sqrt(fx * fy) / height / length * np.sqrt(np.clip(cosine, 0, 1))
