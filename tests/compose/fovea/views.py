"""Cameras before a wall, samples of it, and moments of what moves."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from compose.base.arrays import Arrays
from compose.base.traced_samples import DIFFUSE, Moment
from compose.camera.camera import Camera, look_at
from compose.fovea.disc import Disc
from tests.compose.arrays_of import PlainSamples, disc_of

SIZE = 48


def camera(x: float = 0.0, turn: float = 0.0) -> Camera:
    """48 x 48 pixels at (x, 0, -4), looking along +z, turned by degrees."""
    target = [x + np.sin(np.radians(turn)), 0, -4 + np.cos(np.radians(turn))]
    pose = look_at(np.array([x, 0.0, -4]), np.array(target), np.array([0.0, -1, 0]))
    return Camera(np.linalg.inv(pose), SIZE, SIZE, SIZE, SIZE, SIZE / 2, SIZE / 2)


def wall(view: Camera, z: np.ndarray | float = 0.0) -> np.ndarray:
    """(D, 3) points where the rays through all pixels' centres meet the plane at z."""
    rays = view.rays(view.pixel_centres())
    return view.position + rays * ((z - view.position[2]) / rays[:, 2])[:, None]


def samples(
    position: np.ndarray, radiance: np.ndarray, gloss: int = DIFFUSE, count: float = 1, mover: int = 0
) -> PlainSamples:
    """Samples of the first D pixels that hit positions (D, 3); albedo and normal are the radiance, too."""
    size = len(position)
    flat = np.broadcast_to(np.asarray(radiance, dtype=np.float32), (size, 3)).astype(np.float32)
    with np.errstate(over="ignore"):
        squares = flat**2
    return PlainSamples(
        np.arange(size, dtype=np.uint32),
        np.full(size, count, dtype=np.float32),
        flat,
        squares,
        flat,
        flat,
        position.astype(np.float32),
        np.full(size, gloss, dtype=np.uint8),
        np.full(size, mover, dtype=np.uint16),
        np.zeros(size, dtype=np.float32),
    )


def whole(arrays: Arrays, view: Camera) -> Disc:
    """A disc of all pixels of a camera's frame."""
    size = view.width * view.height
    return disc_of(
        arrays, view.width, view.height, np.arange(size, dtype=np.uint32), np.ones(size, np.float32)
    )


def random_moment(rng: np.random.Generator, time: float, size: float) -> Moment:
    """Two movers, turned and shifted by about a size."""
    turns = Rotation.from_rotvec(rng.normal(0, size, (2, 3))).as_matrix()
    moved = np.concatenate([turns, rng.normal(0, size, (2, 3, 1))], axis=2)
    return Moment(time, np.concatenate([np.eye(4)[None, :3], moved]))
