"""Chooses training views: in free space around the scene's own camera, not too near to surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Array, Camera, camera_from_pose
from compose.camera.turning import turned
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces

# All lengths are in units of the median distance to what the scene's own camera sees, so that scenes in
# millimetres and in metres get the same views.
_REACH = 0.12  # largest distance of a view from the scene's own camera
_CLEARANCE = 0.02  # smallest distance of a view from any surface
_NEAR = 0.15  # surfaces nearer than this are too near to look at
_NEAR_SHARE = 0.1  # largest share of the frame that may show such surfaces
_YAW, _PITCH = 20.0, 10.0  # largest turns, degrees to either side
# In a narrower field of view, given by the tangent of its half, reach and turns shrink with it: views that
# did not overlap would show nothing twice.
_NARROW = 0.3
_TRIES_PER_VIEW = 200
# Unlikely to be the seed of a training.
_UNSEEN_SEED = 7919
# Views turned further than all others, in units of the largest yaw and pitch: without them, hardly any frame
# would show what lies at the edge of every other view.
_BORDER = tuple((x, y) for x in (-1.6, 0.0, 1.6) for y in (-1.6, 0.0, 1.6) if (x, y) != (0.0, 0.0))


@dataclass(frozen=True)
class ViewSet:
    """Chosen cameras.

    Attributes:
        fixed: the scene's own camera, then the same turned to the border of what the others see.
        spread: spread evenly over positions and directions; any of them may be held out of training.
    """

    fixed: list[Camera]
    spread: list[Camera]


def unseen_views(scene: Scene, count: int, width: int, height: int) -> list[Camera]:
    """Views around the scene's own camera to measure on, which differ from those of any training.

    Args and raises as of `choose_views`.
    """
    neighbourhood = _Neighbourhood.of(scene, Surfaces(scene), width, height)
    return neighbourhood.spread(count, _UNSEEN_SEED)


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
    neighbourhood = _Neighbourhood.of(scene, surfaces, width, height)
    fixed = [neighbourhood.home]
    if count > 2 * len(_BORDER):
        fixed += neighbourhood.border()
    return ViewSet(fixed, neighbourhood.spread(count - len(fixed), seed))


@dataclass(frozen=True)
class _Neighbourhood:
    """The space around the scene's own camera, at the scale of what it sees.

    Attributes:
        name: the scene's, for error messages.
        surfaces: the scene's surfaces.
        home: the scene's own camera at the size of the frames.
        scale: median distance to what it sees.
        share: of the reach and the turns that views have in a field of view of ordinary width, at most 1.
    """

    name: str
    surfaces: Surfaces
    home: Camera
    scale: float
    share: float

    @staticmethod
    def of(scene: Scene, surfaces: Surfaces, width: int, height: int) -> _Neighbourhood:
        """The neighbourhood of a scene's own camera; UserError if that sees nothing."""
        home = scene.camera.resized(width, height)
        scale = surfaces.median_distance(home)
        if not np.isfinite(scale):
            raise UserError(f"{scene.name}: the scene's own camera sees no surface")
        tangent = min(width / home.fx, height / home.fy) / 2
        return _Neighbourhood(scene.name, surfaces, home, scale, min(1.0, tangent / _NARROW))

    def border(self) -> list[Camera]:
        """The scene's own camera, turned to the border of what other views see."""
        views = [_moved(self.home, np.zeros(3), x * self.share, y * self.share) for x, y in _BORDER]
        return [view for view in views if self._is_usable(view)]

    def spread(self, count: int, seed: int) -> list[Camera]:
        """Views spread evenly over positions and directions; UserError if there is no space for them."""
        # Takes a second to import, which frames that need no views should not wait for.
        from scipy.stats import qmc

        found: list[Camera] = []
        sequence = qmc.Halton(5, seed=seed)
        for _ in range(count * _TRIES_PER_VIEW):
            if len(found) == count:
                break
            u = sequence.random(1)[0]
            offset = _in_ball(u[:3]) * _REACH * self.share * self.scale
            candidate = _moved(self.home, offset, *((2 * u[3:] - 1) * self.share))
            if self._is_usable(candidate):
                found.append(candidate)
        if len(found) < count:
            raise UserError(
                f"{self.name}: only {len(found)} of {count} further views fit into the free space around the "
                "scene's camera; ask for fewer views"
            )
        return found

    def _is_usable(self, candidate: Camera) -> bool:
        """Whether a view is reachable from the scene's own camera and not too near to surfaces."""
        if not self.surfaces.sees(self.home.position, candidate.position):
            return False
        if self.surfaces.clearance(candidate.position) < _CLEARANCE * self.scale:
            return False
        distance = self.surfaces.probe(candidate)
        return float(np.mean(distance < _NEAR * self.scale)) <= _NEAR_SHARE


def _in_ball(u: Array) -> Array:
    """A point (3,) of the unit ball from three numbers in 0..1, uniform in volume."""
    z, turn = 2 * u[0] - 1, 2 * np.pi * u[1]
    radius = np.sqrt(1 - z * z)
    return np.array([radius * np.cos(turn), radius * np.sin(turn), z]) * u[2] ** (1 / 3)


def _moved(home: Camera, offset: Array, yaw_share: float, pitch_share: float) -> Camera:
    """The camera moved by an offset (3,) and turned by shares of the largest yaw and pitch."""
    pose = home.camera_to_world
    moved = np.eye(4)
    moved[:3, :3] = turned(pose[:3, :3], yaw_share * _YAW, pitch_share * _PITCH)
    moved[:3, 3] = pose[:3, 3] + offset
    return camera_from_pose(moved, home.width, home.height, home.fx, home.fy, home.cx, home.cy)
