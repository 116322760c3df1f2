"""Which parts of a view a forest knows: those that its training views saw from no much greater distance."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, minimum_filter

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.camera.seen import SeenSurfaces
from hybrid.frame.trained_views import views_of
from pathtrace.trace.film import box_positions, interleaved
from pathtrace.trace.first_hit import SKY_DISTANCE
from pathtrace.trace.tracer import Tracer
from splat.lod.renderer import ForestRenderer
from splat.model.forest import Forest
from splat.raster.tiles import TILE

# Rows and columns of the depth map of a training view.
_MAP = 64
# Rays by which a view is tried, at most: where there are more tiles, a ray stands for several of them.
_MOST_RAYS = 2048
# Distance from which a few training views saw a point, over that from which it is seen now: up to the
# first, splats show it well; from the second on they are blurred and out of shape.
_NEAR, _FAR = 1.6, 2.4
# Cells beside what is not known that count as such.
_BORDER = 2
# Opacity of splats up to which a pixel counts as unknown, and from which on as known, where nothing is known
# of training views.
_EMPTY, _FULL = 0.5, 0.9
# log2 of a tile's side: sampling rate at which opacity is drawn.
_TILE_RATE = int(np.log2(TILE))


class Coverage:
    """Tells what a forest knows of its scene.

    Args:
        arrays: the backend's array types.
        forest: the forest; of its training views where it says which they were, else of what is opaque.
    """

    def __init__(self, arrays: Arrays, forest: Forest):
        self._arrays, self._forest = arrays, forest
        self._views = views_of(forest)
        self._seen: SeenSurfaces | None = None

    def cell(self, camera: Camera) -> int:
        """Side in pixels of the cells in which a frame is tried."""
        side = TILE
        while -(-camera.width // side) * -(-camera.height // side) > _MOST_RAYS:
            side *= 2
        return side

    def of(self, camera: Camera, tracer: Tracer) -> NDArray[np.float32]:
        """(rows, columns) how well the splats show each cell of a frame, 0 where not at all to 1.

        Up to two cells beside one that is not known count as that one, since few views showed what is there,
        and Gaussians smear. A single cell that differs from those around it counts as these do.

        Args:
            camera: the view.
            tracer: of the scene.
        """
        side = self.cell(camera)
        points = _points(tracer, camera, side)
        known = self._of_points(points, camera, tracer) if self._views else self._opaque(camera, side)
        known = known.reshape(-(-camera.height // side), -(-camera.width // side))
        if tracer.scene.mitsuba.environment() is None:
            # Darkness, which splats show as well as paths do.
            known[_is_sky(points, camera).reshape(known.shape)] = 1
        plain = median_filter(known, 3, mode="nearest")
        return minimum_filter(plain, 2 * _BORDER + 1, mode="nearest")

    def _of_points(self, points: NDArray[np.float32], camera: Camera, tracer: Tracer) -> NDArray[np.float32]:
        """(N,) how well the training views saw points (N, 3) of a view."""
        if self._seen is None:
            self._seen = self._seen_by_training(tracer)
        pixel = self._seen.finest(points)
        depth = points @ camera.world_to_camera[2, :3].astype(np.float32) + np.float32(
            camera.world_to_camera[2, 3]
        )
        ratio = pixel * self._forest.trained_focal / np.maximum(depth, np.finfo(np.float32).tiny)
        return np.clip((_FAR - ratio) / (_FAR - _NEAR), 0, 1).astype(np.float32)

    def _seen_by_training(self, tracer: Tracer) -> SeenSurfaces:
        depths = []
        for camera in self._views:
            rows, columns = (min(_MAP, side) for side in (camera.height, camera.width))
            depths.append(_depths(tracer, camera, rows, columns))
        return SeenSurfaces(self._arrays, self._views, np.stack(depths))

    def _opaque(self, camera: Camera, side: int) -> NDArray[np.float32]:
        """(rows, columns) the share of full opacity that the coarsest layer has in each cell."""
        image = self._coarse.render_layer(camera, 1, _TILE_RATE)
        if not image.nodes:
            return np.zeros((-(-camera.height // side), -(-camera.width // side)), dtype=np.float32)
        samples = image.values.numpy().reshape(-1, image.stride, image.channels)
        opacity = samples[: image.height : side // TILE, : image.width : side // TILE, -1]
        return np.clip((opacity - _EMPTY) / (_FULL - _EMPTY), 0, 1).astype(np.float32)

    @cached_property
    def _coarse(self) -> ForestRenderer:
        """Draws the coarsest layer alone."""
        forest, layer = self._forest, self._forest.layers[0]
        focal = forest.focal_of(1)
        alone = Forest(layer, (len(layer),), focal, forest.scene_name, forest.scene_hash, {}, forest.place)
        return ForestRenderer(self._arrays, alone)


def _points(tracer: Tracer, camera: Camera, side: int) -> NDArray[np.float32]:
    """(N, 3) apparent position of what a ray in each cell hits, row by row."""
    top, left = (np.arange(0, size, side, dtype=np.float32) for size in (camera.height, camera.width))
    tall, wide = (
        np.minimum(side, size - first) for first, size in ((top, camera.height), (left, camera.width))
    )
    grids = (np.meshgrid(a, b, indexing="ij") for a, b in ((top, left), (tall, wide)))
    (y, x), (height, width) = ([axis.ravel() for axis in grid] for grid in grids)
    found = tracer.auxiliary(camera, box_positions(x, y, width, height), 1, 0)
    return interleaved(found.position)


def _depths(tracer: Tracer, camera: Camera, rows: int, columns: int) -> NDArray[np.float32]:
    """(rows, columns) depth along the view axis of what a view's cells show."""
    tall, wide = camera.height / rows, camera.width / columns
    y, x = (axis.ravel() for axis in np.mgrid[0:rows, 0:columns])
    size = np.full(len(x), tall), np.full(len(x), wide)
    found = tracer.auxiliary(camera, box_positions(x * wide, y * tall, size[1], size[0]), 1, 0)
    points = interleaved(found.position)
    depth = points @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    return depth.astype(np.float32).reshape(rows, columns)


def _is_sky(points: NDArray[np.float32], camera: Camera) -> NDArray[np.bool_]:
    """(N,) whether points (N, 3) are beyond the scene."""
    return np.asarray(np.abs(points - camera.position).max(axis=1) > SKY_DISTANCE / 4)
