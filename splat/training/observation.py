"""What frames show, as far as it tells what moves: appearance, points, and smooth surfaces of one colour."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from compose.camera.camera import Camera

# Added to radiance before its logarithm is taken.
_DARK = 0.01


@dataclass(frozen=True)
class Observation:
    """One frame of something that may move."""

    camera: Camera
    radiance: NDArray[np.float32]  # (H, W, 3) float32, linear
    # (H, W) float32 along the ray to what is seen, as it is known or as a forest renders it; inf where
    # nothing is.
    distance: NDArray[np.float32]
    time: float  # that the frame shows, from 0 to 1
    albedo: NDArray[np.float32] | None = None  # (H, W, 3) float32; None if it is not known

    @cached_property
    def appearance(self) -> NDArray[np.float32]:
        """(H, W, 3) what surfaces look like whatever the light: albedo, else the logarithm of radiance.

        A light that changes by a factor adds the same to that logarithm everywhere.
        """
        if self.albedo is not None:
            return self.albedo
        return np.log(np.maximum(self.radiance, 0) + _DARK).astype(np.float32)

    @property
    def known(self) -> NDArray[np.bool_]:
        """(H, W) whether anything is seen at a distance."""
        return np.isfinite(self.distance) & (self.distance > 0)

    @cached_property
    def inverse_depth(self) -> NDArray[np.float32]:
        """(H, W) one over the depth along the view axis, linear in the frame on a plane; 0 at infinity."""
        rays = self.camera.rays(self.camera.pixel_centres())
        cosine = (rays @ self.camera.world_to_camera[2, :3]).reshape(self.distance.shape)
        depth = np.where(self.known, self.distance, 1) * cosine
        return np.where(self.known, 1 / depth, 0).astype(np.float32)

    @cached_property
    def nearest(self) -> NDArray[np.float32]:
        """(H, W) nearest depth within a pixel of each; infinite where nothing is."""
        return _depths(-minimum_filter(-self.inverse_depth, 3))

    @cached_property
    def farthest(self) -> NDArray[np.float32]:
        """(H, W) farthest depth within a pixel of each; infinite where nothing is."""
        return _depths(minimum_filter(self.inverse_depth, 3))

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(H, W, 3) world positions of what is seen; NaN where nothing is."""
        rays = self.camera.rays(self.camera.pixel_centres()).reshape(*self.distance.shape, 3)
        distance = np.where(self.known, self.distance.astype(np.float64), np.nan)
        return self.camera.position + rays * distance[..., None]


def _depths(inverse: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1), np.inf).astype(np.float32)


# Pixels that neighbours on one surface may lie apart, across it.
_STEP = 2.0
# Largest difference of appearance between neighbours on one surface.
_COLOUR = 0.08


def surfaces_of(points: NDArray[np.float64], appearance: NDArray[np.float32]) -> NDArray[np.int64]:
    """(H, W) number of the surface that each pixel shows, from 0; -1 for none.

    Neighbouring pixels show the same surface if one lies in the plane of the other, or nearly, and they look
    nearly alike. Points (H, W, 3) are in world space, NaN where nothing is seen; appearance is (H, W, 3).
    """
    height, width = points.shape[:2]
    known = np.asarray(np.isfinite(points).all(axis=-1))
    normal, size = _planes(points)
    number = np.arange(height * width).reshape(height, width)
    links = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        way = points[b] - points[a]
        across = np.minimum(
            np.abs((normal[a] * way).sum(axis=-1)) / size[a], np.abs((normal[b] * way).sum(axis=-1)) / size[b]
        )
        alike = np.abs(appearance[b] - appearance[a]).max(axis=-1) < _COLOUR
        joined = known[a] & known[b] & alike & (across < _STEP)
        links.append((number[a][joined], number[b][joined]))
    first, second = (np.concatenate(part) for part in zip(*links, strict=True))
    graph = coo_matrix((np.ones(len(first)), (first, second)), shape=(number.size, number.size))
    _, found = connected_components(graph, directed=False)
    return np.where(known, found.reshape(height, width), -1).astype(np.int64)


def _planes(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(H, W, 3) unit normals, of the flatter side of each pixel, and (H, W) sizes of pixels."""
    steps = []
    for axis in (0, 1):
        ahead = np.diff(points, axis=axis, append=np.nan)
        behind = np.diff(points, axis=axis, prepend=np.nan)
        lengths = [np.where(np.isnan(s[..., 0]), np.inf, (s**2).sum(axis=-1)) for s in (ahead, behind)]
        steps.append(np.where((lengths[0] <= lengths[1])[..., None], ahead, behind))
    normal = np.cross(steps[0], steps[1])
    length = np.linalg.norm(normal, axis=-1)
    size = np.minimum(*(np.linalg.norm(step, axis=-1) for step in steps))
    unit = normal / np.where(length > 0, length, 1)[..., None]
    return np.nan_to_num(unit), np.nan_to_num(size, nan=np.inf) + 1e-12
