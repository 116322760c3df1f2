"""How well views that were trained on cover what a camera sees."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Array, Camera
from pathtrace.scene.surfaces import Surfaces

# Frame in which coverage is looked up: 16 by 9 rays, or as many in other shapes.
_RAYS = 144
# Where nothing is seen, a point so far away, in units of the distances between views, that only its direction
# counts.
_SKY = 1e5
# From a point back to a view, rays end this share of the way before the point: it lies on a surface.
_TOUCH = 1e-3
# Of what a camera sees, what is shown at half of its resolution or more is covered.
_LEAST = 0.5


class Coverage:
    """What a set of views shows of a scene, and how finely.

    A view covers a point if the point lies in its frame, nothing hides it, and the pixels there are fine
    enough. Resolutions are compared as if all frames had the height of the views': how many pixels a display
    has is not for a region to judge, how near its views came to a surface is. Reflections do not count.

    Args:
        surfaces: the scene's surfaces.
        cameras: the views, in the scene's coordinates.
    """

    def __init__(self, surfaces: Surfaces, cameras: list[Camera]):
        self._surfaces, self._cameras = surfaces, list(cameras)

    def add(self, cameras: list[Camera]) -> None:
        """Adds views."""
        self._cameras += cameras

    def map(self, camera: Camera) -> Array:
        """(h, w) how well a camera's frame is covered, from 0 (unseen) to 1 (seen as finely or finer).

        Between the two, values are ratios of resolutions, in pixels per length along a surface. The map has
        the frame's shape, and about 144 values.
        """
        height = max(1, round(float(np.sqrt(_RAYS * camera.height / camera.width))))
        width = max(1, round(_RAYS / height))
        x, y = np.meshgrid(
            (np.arange(width) + 0.5) * camera.width / width,
            (np.arange(height) + 0.5) * camera.height / height,
        )
        rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
        distance, normal = self._surfaces.hits(np.repeat(camera.position[None], len(rays), axis=0), rays)
        is_sky = ~np.isfinite(distance)
        distance[is_sky] = _SKY * self._extent(camera)
        points = camera.position + rays * distance[:, None]
        normal[is_sky] = -rays[is_sky]
        wanted = _resolution(camera, points, normal)
        best = np.zeros(len(rays))
        for view in self._cameras:
            np.maximum(best, self._shown(view, points, normal, is_sky, wanted, best), out=best)
        return best.reshape(height, width)

    def share(self, camera: Camera, least: float = _LEAST) -> float:
        """Share of a camera's frame that is covered at that ratio of resolutions or more, 0..1."""
        return float(np.mean(self.map(camera) >= least))

    def _shown(
        self, view: Camera, points: Array, normal: Array, is_sky: Array, wanted: Array, best: Array
    ) -> Array:
        """(N,) ratio at which a view shows points (N, 3), at most 1; 0 where that is not above `best`."""
        pixel, depth = view.project(points)
        within = (depth > 0) & (pixel >= 0).all(axis=1)
        within &= (pixel[:, 0] < view.width) & (pixel[:, 1] < view.height)
        shown = np.zeros(len(points))
        index = np.flatnonzero(within)
        resolution = _resolution(view, points[index], normal[index])
        ratio = np.minimum(resolution / np.maximum(wanted[index], 1e-300), 1)
        index, ratio = index[ratio > best[index]], ratio[ratio > best[index]]
        ways = points[index] - view.position
        length = np.linalg.norm(ways, axis=1)
        free = self._surfaces.distance(
            np.repeat(view.position[None], len(index), axis=0), ways / length[:, None]
        )
        visible = np.where(is_sky[index], np.isinf(free), free >= (1 - _TOUCH) * length)
        shown[index[visible]] = ratio[visible]
        return shown

    def _extent(self, camera: Camera) -> float:
        """A length that the distances between the camera, the views and the surfaces do not exceed by far."""
        positions = np.array([view.position for view in [camera, *self._cameras]])
        low, high = self._surfaces.bounds
        box = np.linalg.norm(high - low) if np.isfinite(low).all() else 0.0
        return max(float(np.ptp(positions, axis=0).max()), float(box), 1e-30)


def _resolution(camera: Camera, points: Array, normal: Array) -> Array:
    """(N,) frame heights per unit of length along surfaces at points (N, 3) with unit normals (N, 3).

    Seen at a slant, a surface keeps its resolution along one axis and loses it along the other: this is the
    geometric mean. A surface seen from behind has none.
    """
    ways = camera.position - points
    length = np.linalg.norm(ways, axis=1)
    cosine = np.sum(ways * normal, axis=1) / length
    focal = np.sqrt(camera.fx * camera.fy) / camera.height
    return focal / length * np.sqrt(np.clip(cosine, 0, 1))
