"""What the fovea has already seen: samples of earlier frames, carried along with the surfaces they hit.

While the camera stands still, samples add up pixel by pixel, wherever the gaze goes. When it has moved, each
pixel's samples go to the pixel in which their place in the world is seen now. Where they lie in their pixel
is known, so that going from pixel to pixel again and again does not blur: they are moved, never resampled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compose.view import Camera

Array = NDArray[np.float32]

# Nothing farther away counts as another surface if its distance differs by less, relatively.
_SAME_SURFACE = 0.02
# Degrees by which the direction of sight may change until what shines there is another: by gloss.
_MOST_TURN = np.array([np.inf, 2.0, 0.2])
# Samples per pixel that a moving camera remembers: old errors fade.
_MOST_MOVING = 48.0

DIFFUSE, GLOSSY, SPECULAR = 0, 1, 2


@dataclass(frozen=True)
class Samples:
    """Samples of D pixels of one view.

    Attributes:
        pixels: (D,) row-major indices, each once.
        count: (D,) samples in each.
        radiance: (D, 3) their mean, linear.
        squares: (D, 3) mean of their squares.
        albedo, normal: (D, 3) their means.
        position: (D, 3) in the world, where one of them met a surface; far away where none did.
        gloss: (D,) DIFFUSE, GLOSSY or SPECULAR, of that surface.
    """

    pixels: NDArray[np.uint32]
    count: Array
    radiance: Array
    squares: Array
    albedo: Array
    normal: Array
    position: Array
    gloss: NDArray[np.uint8]

    def variance(self) -> Array:
        """(D, 3) of the mean radiance; inf where one sample does not tell."""
        count = self.count[:, None]
        spread = np.maximum(self.squares - self.radiance**2, 0)
        with np.errstate(divide="ignore"):
            return np.where(count > 1, spread / np.maximum(count - 1, 1e-6), np.inf).astype(np.float32)


class History:
    """Samples of all pixels of a view, as far as anything has been seen of them.

    The world must not change: make another history then.
    """

    def __init__(self) -> None:
        self._camera: Camera | None = None

    def add(self, camera: Camera, new: Samples) -> Samples:
        """Remembers new samples.

        Returns:
            The new samples' pixels, with all that is remembered of them.
        """
        if self._camera is None or (self._camera.width, self._camera.height) != (camera.width, camera.height):
            self._forget(camera)
        elif self._camera.key != camera.key:
            self._move(camera, new)
        pixels = new.pixels
        old_count, count = self._count[pixels], new.count
        total = (old_count + count)[:, None]
        fresh = np.hstack([new.radiance, new.squares, new.albedo, new.normal])
        means = (self._means[pixels] * old_count[:, None] + fresh * count[:, None]) / total
        # Between two surfaces there is nothing: only places on the same one are averaged.
        same = _distances_agree(camera, self._position[pixels], new.position) & (old_count > 0)
        middle = (self._position[pixels] * old_count[:, None] + new.position * count[:, None]) / total
        position = np.where(same[:, None], middle, new.position)
        self._means[pixels], self._count[pixels] = means, total[:, 0]
        self._position[pixels], self._gloss[pixels] = position, new.gloss
        self._seen_from[pixels] = camera.position
        return replace(
            new,
            count=total[:, 0],
            radiance=means[:, 0:3],
            squares=means[:, 3:6],
            albedo=means[:, 6:9],
            normal=means[:, 9:12],
        )

    def _forget(self, camera: Camera) -> None:
        size = camera.width * camera.height
        self._camera = camera
        self._means = np.zeros((size, 12), dtype=np.float32)
        self._count = np.zeros(size, dtype=np.float32)
        self._position = np.zeros((size, 3), dtype=np.float32)
        self._seen_from = np.zeros((size, 3), dtype=np.float32)
        self._gloss = np.zeros(size, dtype=np.uint8)

    def _move(self, camera: Camera, new: Samples) -> None:
        """Takes every pixel's samples to where their place is seen now; drops those that no longer hold."""
        seen = np.flatnonzero(self._count)
        means, count, position = self._means[seen], self._count[seen], self._position[seen]
        seen_from, gloss = self._seen_from[seen], self._gloss[seen]
        pixel, depth = camera.project(position.astype(np.float64))
        column, row = np.floor(pixel[:, 0]), np.floor(pixel[:, 1])
        kept = (depth > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        kept &= _turn(position, seen_from, camera.position) <= _MOST_TURN[gloss]
        target = np.where(kept, row * camera.width + column, 0).astype(np.int64)
        distance = np.linalg.norm(position - camera.position, axis=1)
        nearest, farthest = _distance_range(camera, new)
        kept &= (distance >= nearest[target] * (1 - _SAME_SURFACE)) & (
            distance <= farthest[target] * (1 + _SAME_SURFACE)
        )
        self._forget(camera)
        chosen = np.flatnonzero(kept)
        if not len(chosen):
            return
        order = chosen[np.lexsort((-distance[chosen], target[chosen]))]
        places, first = np.unique(target[order], return_index=True)
        weight = count[order]
        total = np.add.reduceat(weight, first)
        self._count[places] = np.minimum(total, _MOST_MOVING)
        self._means[places] = np.add.reduceat(means[order] * weight[:, None], first) / total[:, None]
        # The nearest one lies last.
        last = order[np.append(first[1:], len(order)) - 1]
        self._position[places], self._gloss[places] = position[last], gloss[last]
        self._seen_from[places] = seen_from[last]


def _turn(position: Array, before: Array, now: NDArray[np.float64]) -> NDArray[np.float64]:
    """Degrees between the directions in which places were seen and are seen."""
    one, other = position - before, position - now
    sine = np.linalg.norm(np.cross(one, other), axis=1)
    return np.degrees(np.arctan2(sine, (one * other).sum(axis=1)))


def _distances_agree(camera: Camera, one: Array, other: Array) -> NDArray[np.bool_]:
    first, second = (np.linalg.norm(place - camera.position, axis=1) for place in (one, other))
    return np.abs(first - second) <= _SAME_SURFACE * second


def _distance_range(camera: Camera, new: Samples) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(H * W,) nearest and farthest of what is seen now in each pixel and its neighbours; any elsewhere."""
    distance = np.linalg.norm(new.position - camera.position, axis=1)
    extremes = []
    for unknown, choose in ((np.inf, np.minimum), (-np.inf, np.maximum)):
        image = np.full(camera.width * camera.height, unknown)
        image[new.pixels] = distance
        padded = np.pad(image.reshape(camera.height, camera.width), 1, constant_values=unknown)
        across = choose(choose(padded[:, :-2], padded[:, 1:-1]), padded[:, 2:])
        around = choose(choose(across[:-2], across[1:-1]), across[2:])
        extremes.append(np.where(np.isfinite(around), around, -unknown).ravel())
    nearest, farthest = extremes
    return np.where(nearest == -np.inf, 0, nearest), farthest
