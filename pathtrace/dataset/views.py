"""The views of a capture around the scene's own camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compose.camera.camera import Camera
from compose.camera.view import View
from pathtrace.region.near import BORDER, UNSEEN_SEED, Neighbourhood
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces

# Multiples of the golden ratio, modulo 1, are evenly spread however many they are.
_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class ViewSet:
    """Chosen cameras.

    Attributes:
        fixed: the scene's own camera, then the same turned to the border of what the others see.
        spread: spread evenly over positions and directions, or along a path; any of them may be held out of
            training.
        times: that all of them show, from 0 to 1, the fixed ones first; 0 if nothing moves.
    """

    fixed: list[Camera]
    spread: list[Camera]
    times: list[float]


def unseen_views(scene: Scene, count: int, width: int, height: int) -> list[View]:
    """Views around the scene's own camera to measure on, which differ from those of any training.

    Of a scene that moves, they show times half a step from those of training views.

    Args and raises as of `choose_views`.
    """
    neighbourhood = Neighbourhood.of(scene, Surfaces(scene), width, height)
    cameras = neighbourhood.spread(count, UNSEEN_SEED)
    return [View(camera, unseen_time(scene, number)) for number, camera in enumerate(cameras)]


def choose_views(scene: Scene, surfaces: Surfaces, count: int, width: int, height: int, seed: int) -> ViewSet:
    """Views around the scene's own camera.

    Args:
        scene: the scene.
        surfaces: its surfaces.
        count: number of views in all; with 16 or fewer, only the scene's own camera is fixed.
        width, height: frame size in pixels.
        seed: same seed, same views.

    Raises:
        UserError: the scene's own camera sees no surface, or there is no free space for that many views.
    """
    neighbourhood = Neighbourhood.of(scene, surfaces, width, height)
    fixed = [neighbourhood.home]
    if count > 2 * len(BORDER):
        fixed += neighbourhood.border()
    times = view_times(scene, count)
    return ViewSet(fixed, neighbourhood.spread(count - len(fixed), seed), times)


def monocular_views(scene: Scene, surfaces: Surfaces, count: int, width: int, height: int) -> ViewSet:
    """Views of one camera that sways around the scene's own, one instant after the other, as of a video.

    Args and raises as of `choose_views`.
    """
    shares = np.linspace(0, 1, count)
    cameras = Neighbourhood.of(scene, surfaces, width, height).path(shares.tolist())
    return ViewSet([], cameras, [0.0 if scene.moving is None else float(share) for share in shares])


def time_of(number: float) -> float:
    """The time from 0 to 1 that a view shows of a scene that moves; views have all times alike."""
    return (0.5 + number * _GOLDEN) % 1


def unseen_time(scene: Scene, number: int) -> float:
    """The time that a view to measure on shows: half a step from those of training; 0 if nothing moves."""
    return _time(scene, number + 0.5)


def view_times(scene: Scene, count: int) -> list[float]:
    """The times that views to train on show; 0 if nothing moves."""
    return [_time(scene, number) for number in range(count)]


def _time(scene: Scene, number: float) -> float:
    return 0.0 if scene.moving is None else time_of(number)
