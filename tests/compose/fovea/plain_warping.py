"""The plain twin of compose.fovea.warping: NumPy, float64, one cell and one pixel after the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.fovea.warping import grid

Floats = NDArray[np.float64]
SIDE = 4


def plain_warped(image: Floats, nearness: Floats, camera: Camera, newest: Camera) -> Floats:
    """(H, W, 3) from an image (H, W, 3) and inverse depths (rows, columns)."""
    outlined, found = _outlined(nearness), np.zeros(grid(camera))
    moved = np.linalg.norm(newest.position - camera.position) * max(camera.fx, camera.fy)
    nearest = min(outlined.max(), 64 / max(moved, 1e-4))
    for i, j in np.ndindex(*found.shape):
        found[i, j] = _searched(outlined, np.array([j + 0.5, i + 0.5]) * SIDE, nearest, camera, newest)
    result = np.zeros_like(image)
    for row, column in np.ndindex(*image.shape[:2]):
        pixel = np.array([column + 0.5, row + 0.5])
        own = sampled(found[..., None], pixel / SIDE)[0]
        result[row, column] = sampled(image, seen_from(camera, newest, pixel, own))
    return result


def seen_from(camera: Camera, newest: Camera, pixel: Floats, nearness: float) -> Floats:
    """(2,) where in a camera's frame a point lies that is at a pixel of the newest, by its inverse depth."""
    x, y = (pixel - (newest.cx, newest.cy)) / (newest.fx, newest.fy)
    # Divided by the depth, so that it may be infinite.
    point = camera.world_to_camera @ newest.camera_to_world @ np.array([x, y, 1, nearness])
    return point[:2] / max(point[2], 1e-4) * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def sampled(image: Floats, position: Floats) -> Floats:
    """(C,) an image (H, W, C) at a position in pixels, linear between them; its border beyond it."""
    height, width = image.shape[:2]
    x, y = np.clip(position - 0.5, 0, (width - 1, height - 1))
    j, i = int(x), int(y)
    right, below = min(j + 1, width - 1), min(i + 1, height - 1)
    above = (1 - (x - j)) * image[i, j] + (x - j) * image[i, right]
    return (1 - (y - i)) * above + (y - i) * ((1 - (x - j)) * image[below, j] + (x - j) * image[below, right])


def _outlined(nearness: Floats) -> Floats:
    outlined = nearness.copy()
    for i, j in np.ndindex(*nearness.shape):
        around = nearness[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2].max()
        if around > 1.2 * nearness[i, j]:
            outlined[i, j] = around
    return outlined


def _searched(nearness: Floats, pixel: Floats, nearest: float, camera: Camera, newest: Camera) -> float:
    """Inverse depth of what the newest camera sees at a pixel."""
    ahead = camera.world_to_camera[2] @ newest.camera_to_world
    ray = np.array([*(pixel - (newest.cx, newest.cy)) / (newest.fx, newest.fy), 1])

    def seen_at(other: float) -> float:
        return float(other * (ahead[:3] @ ray) / max(1 - other * ahead[3], 1e-4))

    seen = -1.0
    for share in (1, 2 / 3, 1 / 3, 0):
        own = seen_at(nearest * share)
        position, met = seen_from(camera, newest, pixel, own), []
        for _ in range(4):
            j, i = np.clip(position / SIDE, 0, np.array(nearness.shape[::-1]) - 1).astype(int)
            met.append((nearness[i, j], own))
            own, before = seen_at(nearness[i, j]), position
            position = seen_from(camera, newest, pixel, own)
        if np.abs(position - before).max() < 1:
            seen = max(seen, own)
    return seen if seen >= 0 else min(met, key=lambda pair: pair[0])[1]
