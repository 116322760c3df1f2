"""Draws views of a region at random, and keeps those that show something."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from pathtrace.region.looks import Looks
from pathtrace.scene.surfaces import Surfaces

# Side of the coarse frames that say what a view shows.
_SIDE = 12
# Largest share of a frame with surfaces that are too near, and smallest with any surface at all.
_NEAR_SHARE, _SEEN_SHARE = 0.1, 0.3
_TRIES = 24
# Streams of random numbers: what is trained on must not be what is judged.
TRAINING, JUDGING, VIEWING = 0, 1, 2


def generator(seed: int, stream: int, number: int = 0) -> np.random.Generator:
    """Random numbers of a stream; `number` tells its parts apart."""
    return np.random.default_rng([seed, stream, number])


def drawn(
    count: int, propose: Callable[[int], Looks], surfaces: Surfaces, like: Camera, near: float
) -> Looks:
    """Up to `count` views that show something, and not only from too near.

    Args:
        count: of views.
        propose: gives that many views.
        surfaces: of the scene.
        like: camera that has the views' intrinsics.
        near: surfaces nearer than this are too near to look at.

    Returns:
        Fewer views, or none, where hardly one in 24 shows anything.
    """
    positions, rotations, total = [], [], 0
    for _ in range(_TRIES):
        looks = propose(count)
        looks = looks[_shows(looks, surfaces, like, near)]
        positions.append(looks.positions)
        rotations.append(looks.rotations)
        total += len(looks)
        if total >= count:
            break
    return Looks(np.concatenate(positions)[:count], np.concatenate(rotations)[:count])


def _shows(looks: Looks, surfaces: Surfaces, like: Camera, near: float) -> NDArray[np.bool_]:
    distance = looks.probe(surfaces, like, _SIDE)
    too_near = np.mean(distance < near, axis=1)
    seen = np.mean(np.isfinite(distance), axis=1)
    return (too_near <= _NEAR_SHARE) & (seen >= _SEEN_SHARE)
