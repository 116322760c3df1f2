"""Chooses training views: in free space, joined to the scene's own camera, at a sane distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Array, Camera, camera_from_pose
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces

# All lengths are in units of the median distance that the scene's own camera sees, so that a scene
# in millimetres and one in metres get the same views.
_REACH = 0.12  # how far views lie from the scene's own camera
_CLEARANCE = 0.02  # no surface nearer to the camera than this
_NEAR = 0.15  # what counts as too near to look at
_NEAR_SHARE = 0.1  # share of the frame that may be nearer
_YAW, _PITCH = 20.0, 10.0  # degrees, one side
_PROBE = 24  # rays per side of the probing frame
_TRIES_PER_VIEW = 200
# No seed that anyone would train with.
_UNSEEN_SEED = 7919
# Views turned further than all others, in units of the largest yaw and pitch: without them the edge of
# every other view's picture would be a place that hardly any frame shows.
_BORDER = tuple((x, y) for x in (-1.6, 0.0, 1.6) for y in (-1.6, 0.0, 1.6) if (x, y) != (0.0, 0.0))


@dataclass(frozen=True)
class ViewSet:
    """Chosen cameras.

    Attributes:
        fixed: the scene's own camera, and those turned to the border of what the others see.
        spread: evenly spread over positions and directions; any of them may be held out of training.
    """

    fixed: list[Camera]
    spread: list[Camera]


def unseen_views(scene: Scene, count: int, width: int, height: int) -> list[Camera]:
    """Views around the scene's own camera to measure on: others than those that training has seen.

    Args and raises as of `choose_views`.
    """
    neighbourhood = _Neighbourhood.of(scene, Surfaces(scene), width, height)
    return neighbourhood.spread(count, _UNSEEN_SEED)


def choose_views(scene: Scene, surfaces: Surfaces, count: int, width: int, height: int, seed: int) -> ViewSet:
    """Views around the scene's own camera.

    Args:
        scene, surfaces: the scene and its Embree tree.
        count: how many in all; few views are all spread, but for the scene's own.
        width, height: frame size in pixels.
        seed: same seed, same views.

    Raises:
        UserError: the scene leaves no room for that many views.
    """
    neighbourhood = _Neighbourhood.of(scene, surfaces, width, height)
    fixed = [neighbourhood.home]
    if count > 2 * len(_BORDER):
        fixed += neighbourhood.border()
    return ViewSet(fixed, neighbourhood.spread(count - len(fixed), seed))


@dataclass(frozen=True)
class _Neighbourhood:
    """Where views may lie: around the scene's own camera, at the scale of what it sees."""

    name: str
    surfaces: Surfaces
    home: Camera
    scale: float

    @staticmethod
    def of(scene: Scene, surfaces: Surfaces, width: int, height: int) -> _Neighbourhood:
        """Raises UserError where the scene's own camera sees nothing."""
        home = scene.camera.resized(width, height)
        scale = _median_distance(home, surfaces)
        if not np.isfinite(scale):
            raise UserError(f"{scene.name}: the scene's own camera sees no surface")
        return _Neighbourhood(scene.name, surfaces, home, scale)

    def border(self) -> list[Camera]:
        """The scene's own camera, turned to where others would show no more."""
        turned = [_moved(self.home, np.zeros(3), yaw, pitch) for yaw, pitch in _BORDER]
        return [view for view in turned if self._is_sane(view)]

    def spread(self, count: int, seed: int) -> list[Camera]:
        """Views spread evenly over positions and directions; UserError where there is no room for as many."""
        # Takes a second to import, which a frame rendered with a forest at hand need not wait for.
        from scipy.stats import qmc

        found: list[Camera] = []
        sequence = qmc.Halton(5, seed=seed)
        for _ in range(count * _TRIES_PER_VIEW):
            if len(found) == count:
                break
            u = sequence.random(1)[0]
            candidate = _moved(self.home, _in_ball(u[:3]) * _REACH * self.scale, *(2 * u[3:] - 1))
            if self._is_sane(candidate):
                found.append(candidate)
        if len(found) < count:
            raise UserError(
                f"{self.name}: only {len(found)} of {count} further views fit into the free space around the "
                "scene's camera; ask for fewer with --views"
            )
        return found

    def _is_sane(self, candidate: Camera) -> bool:
        if not self.surfaces.sees(self.home.position, candidate.position):
            return False
        if self.surfaces.clearance(candidate.position) < _CLEARANCE * self.scale:
            return False
        distance = _probe(candidate, self.surfaces)
        return float(np.mean(distance < _NEAR * self.scale)) <= _NEAR_SHARE


def _in_ball(u: Array) -> Array:
    """A point of the unit ball from three numbers in 0..1, uniform in volume."""
    z, turn = 2 * u[0] - 1, 2 * np.pi * u[1]
    radius = np.sqrt(1 - z * z)
    return np.array([radius * np.cos(turn), radius * np.sin(turn), z]) * u[2] ** (1 / 3)


def _moved(home: Camera, offset: Array, yaw_share: float, pitch_share: float) -> Camera:
    """The camera at another place, turned by shares of the largest yaw and pitch."""
    pose = home.camera_to_world
    yaw, pitch = np.radians([yaw_share * _YAW, pitch_share * _PITCH])
    # Yaw about the camera's own upward axis keeps the horizon; pitch about its x axis follows.
    turn_yaw = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    turn_pitch = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    moved = np.eye(4)
    moved[:3, :3] = pose[:3, :3] @ turn_yaw @ turn_pitch
    moved[:3, 3] = pose[:3, 3] + offset
    return camera_from_pose(moved, home.width, home.height, home.fx, home.fy, home.cx, home.cy)


def _probe(camera: Camera, surfaces: Surfaces) -> Array:
    small = camera.resized(_PROBE, _PROBE)
    directions = small.rays(small.pixel_centres())
    return surfaces.distance(np.repeat(camera.position[None], len(directions), axis=0), directions)


def _median_distance(camera: Camera, surfaces: Surfaces) -> float:
    distance = _probe(camera, surfaces)
    seen = distance[np.isfinite(distance)]
    return float(np.median(seen)) if len(seen) else np.inf
