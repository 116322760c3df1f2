"""The neighbourhood of the scene's own camera: a ball of views that look about where it looks.

Captures are trained and measured on such views; those of a scene that moves have times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Array, Camera, View, turned
from pathtrace.scene.scene import Scene
from pathtrace.scene.triangles import Surfaces

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
# How far views from beyond the neighbourhood are from the scene's own camera, in units of its radius, and by
# how much wider than others wide ones are, in tangents, up to a largest one.
_BEYOND, _WIDER, _WIDEST = (1.5, 2.5), 1.6, 2.0
# Sizes of a camera's path that are tried, in units of the reach, and the share of the largest yaw by which it
# looks back to the middle from either end.
_SWAYS, _LOOKS_BACK = (0.7, 0.4, 0.2, 0.1, 0.05), 0.4
# Unlikely to be the seed of a training.
UNSEEN_SEED = 7919
# Views between the scene's own camera and those at the border, which few views can do without.
_BEFORE_BORDER = 3
# The same, before such from elsewhere than the scene's own camera.
_BEFORE_OUTER = 15
_OUTER_TRIES = 20
# Multiples of the golden ratio, modulo 1, are evenly spread however many they are.
_GOLDEN = (5**0.5 - 1) / 2
# Views turned further than all others, in units of the largest yaw and pitch: without them, hardly any frame
# would show what lies at the edge of every other view.
BORDER = tuple((x, y) for x in (-1.6, 0.0, 1.6) for y in (-1.6, 0.0, 1.6) if (x, y) != (0.0, 0.0))


class Neighbourhood:
    """The space around a scene's own camera, or another one, at the scale of what it sees.

    UserError if that is nothing.
    """

    def __init__(
        self, scene: Scene, surfaces: Surfaces, width: int, height: int, camera: Camera | None = None
    ):
        self.scene_name, self.surfaces = scene.name, surfaces
        self.home = (camera or scene.camera).resized(width, height)
        self.scale = surfaces.median_distance(self.home)
        if not np.isfinite(self.scale):
            raise UserError(f"{scene.name}: the scene's own camera sees no surface")
        # Of the reach and the turns that views have in a field of view of ordinary width.
        tangent = min(width / self.home.fx, height / self.home.fy) / 2
        self.share = min(1.0, tangent / _NARROW)

    @property
    def radius(self) -> float:
        """Largest distance of a view from the scene's own camera."""
        return _REACH * self.share * self.scale

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """(N,) whether a viewer can be at points (N, 3)."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        # Rounding of the pose must not put the camera itself outside.
        found = np.linalg.norm(points - self.home.position, axis=1) <= self.radius * (1 + 1e-6)
        inside = points[found]
        joined = self.surfaces.are_joined(np.tile(self.home.position, (len(inside), 1)), inside)
        clear = self.surfaces.clearances(inside) >= _CLEARANCE * self.scale
        is_home = np.linalg.norm(inside - self.home.position, axis=1) <= 1e-6 * self.scale
        found[found] = (joined & clear) | is_home
        return found

    def border(self) -> list[Camera]:
        """The scene's own camera, turned to the border of what other views see."""
        views = [_moved(self.home, np.zeros(3), x * self.share, y * self.share) for x, y in BORDER]
        return [view for view in views if self.is_usable(view)]

    def outer(self, seed: int) -> list[Camera]:
        """The same from elsewhere at the edge of the neighbourhood, where other things are hidden."""
        rng = np.random.default_rng([seed, len(BORDER)])
        views = []
        for x, y in BORDER:
            for direction in (rng.normal(size=3) for _ in range(_OUTER_TRIES)):
                offset = direction / np.linalg.norm(direction) * self.radius
                view = _moved(self.home, offset, x * self.share, y * self.share)
                if self.is_usable(view):
                    views.append(view)
                    break
        return views

    def spread(self, count: int, seed: int) -> list[Camera]:
        """Views spread evenly over positions and directions; UserError if there is no space for them."""
        # Takes a second to import, which frames that need no views should not wait for.
        from scipy.stats import qmc

        sequence = qmc.Halton(5, seed=seed)
        points = (sequence.random(1)[0] for _ in range(count * _TRIES_PER_VIEW))
        turns = lambda u: (2 * u[3:] - 1) * self.share  # noqa: E731
        views = (_moved(self.home, _in_ball(u[:3]) * self.radius, *turns(u)) for u in points)
        found = list(islice(filter(self.is_usable, views), count))
        if len(found) < count:
            raise UserError(
                f"{self.scene_name}: only {len(found)} of {count} further views fit into the free space "
                "around the scene's camera; ask for fewer views"
            )
        return found

    def beyond(self, count: int, apart_from: Array, seed: int) -> list[Camera]:
        """Views from outside the neighbourhood, none near positions (N, 3); fewer than asked for if need be.

        Views near positions are those within half a radius.
        """
        rng = np.random.default_rng([seed, count])
        found: list[Camera] = []
        for _ in range(count * _TRIES_PER_VIEW):
            direction, shares = rng.normal(size=3), rng.uniform(-1, 1, 2) * self.share
            offset = direction / np.linalg.norm(direction) * self.radius * rng.uniform(*_BEYOND)
            view = _moved(self.home, offset, *shares)
            distances = np.linalg.norm(apart_from - view.position, axis=1)
            if distances.min(initial=np.inf) > self.radius / 2 and self.is_usable(view):
                found.append(view)
            if len(found) == count:
                break
        return found

    def path(self, shares: Sequence[float]) -> list[Camera]:
        """Views along a closed path around the scene's own camera, at shares 0 to 1 of it."""
        axes = self.home.camera_to_world[:3, :3]
        for size in _SWAYS:
            found = []
            for turn in 2 * np.pi * np.asarray(shares):
                across, down, ahead = np.sin(turn), np.sin(2 * turn) / 2, np.cos(turn) / 4
                offset = axes @ np.array([across, down, ahead]) * (size * self.radius)
                # It looks back to what it sees.
                found.append(_moved(self.home, offset, -_LOOKS_BACK * size * across * self.share, 0.0))
            if all(map(self.is_usable, found)):
                return found
        return [self.home for _ in shares]

    def is_usable(self, candidate: Camera) -> bool:
        """Whether the camera is reached freely from the middle, and no surface is too near."""
        return (
            self.surfaces.sees(self.home.position, candidate.position)
            and self.surfaces.clearance(candidate.position) >= _CLEARANCE * self.scale
            and float(np.mean(self.surfaces.probe(candidate) < _NEAR * self.scale)) <= _NEAR_SHARE
        )


@dataclass(frozen=True)
class NearRegion:
    """The neighbourhood of the scene's own camera as a region; or of another camera, at some `place`."""

    scene: Scene
    surfaces: Surfaces
    place: Camera | None = None
    name: str = "near"

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """(N,) whether a viewer can be at points (N, 3)."""
        home = self.place or self.scene.camera
        return self._around(home.width, home.height).contains(points)

    def identity(self) -> dict[str, Any]:
        """What tells it from other regions of the same scene."""
        return {"kind": "near"} | ({} if self.place is None else {"place": self.place.key.hex()})

    def views(self, count: int, width: int, height: int, seed: int) -> list[Camera]:
        """Views to train on: the camera itself and views around it; some of these show the border."""
        around = self._around(width, height)
        border = around.border()[: max(0, count - 1 - _BEFORE_BORDER)]
        first, second = _BEFORE_BORDER, _BEFORE_OUTER
        outer = around.outer(seed)[: max(0, count - 1 - second - len(border))]
        spread = around.spread(max(0, count - 1 - len(border) - len(outer)), seed)
        views = [around.home, *spread[:first], *border, *spread[first:second], *outer, *spread[second:]]
        return views[:count]

    def unseen_views(self, count: int, width: int, height: int, seed: int) -> list[Camera]:
        """Held-out validation views."""
        return self._around(width, height).spread(count, UNSEEN_SEED + seed)

    def _around(self, width: int, height: int) -> Neighbourhood:
        return Neighbourhood(self.scene, self.surfaces, width, height, self.place)


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
    return home.at(moved)


@dataclass(frozen=True)
class ViewSet:
    """Chosen cameras, and the times from 0 to 1 that all of them show, the fixed ones first."""

    fixed: list[Camera]  # the scene's own, then the same turned to the border of what the others see
    spread: list[Camera]  # over positions and directions, or along a path; any may be held out of training
    times: list[float]


def unseen_views(scene: Scene, count: int, width: int, height: int) -> list[View]:
    """Views to measure on, between those of any training, in time as well."""
    neighbourhood = Neighbourhood(scene, scene.surfaces(), width, height)
    cameras = neighbourhood.spread(count, UNSEEN_SEED)
    return [View(camera, view_time(scene, number + 0.5)) for number, camera in enumerate(cameras)]


def views_beyond(scene: Scene, trained: Sequence[Camera], count: int, width: int, height: int) -> list[View]:
    """Views from beyond the neighbourhood and away from those of a training; at most `count`."""
    neighbourhood = Neighbourhood(scene, scene.surfaces(), width, height)
    positions = np.array([camera.position for camera in trained]).reshape(-1, 3)
    cameras = neighbourhood.beyond(count, positions, UNSEEN_SEED)
    return [View(camera, view_time(scene, number + 0.5)) for number, camera in enumerate(cameras)]


def wider(view: View) -> View:
    """The view with a field of view that is wider than that of any training view; as wide, if it is huge."""
    camera = view.camera
    half = max(camera.width / camera.fx, camera.height / camera.fy) / 2
    factor = max(1.0, min(_WIDER, _WIDEST / half))
    return replace(view, camera=replace(camera, fx=camera.fx / factor, fy=camera.fy / factor))


def is_elsewhere(scene: Scene, camera: Camera, known: Sequence[Camera]) -> bool:
    """Whether a camera is in the neighbourhood of no known one, and has space around it."""
    surfaces = scene.surfaces()
    try:
        radius = Neighbourhood(scene, surfaces, camera.width, camera.height).radius
        poses = np.array([one.camera_to_world for one in known]).reshape(-1, 4, 4)
        is_near = np.linalg.norm(poses[:, :3, 3] - camera.position, axis=1) <= radius
        alike = poses[:, :3, 2] @ camera.camera_to_world[:3, 2] >= np.cos(np.radians(BORDER[-1][0] * _YAW))
        if (is_near & alike).any():
            return False
        around = Neighbourhood(scene, surfaces, camera.width, camera.height, camera)
    except UserError:
        return False
    return around.is_usable(camera)


def choose_views(scene: Scene, surfaces: Surfaces, count: int, width: int, height: int, seed: int) -> ViewSet:
    """Views around the scene's own camera, `count` in all; UserError without free space for them.

    With 16 or fewer, only that camera is fixed. Same seed, same views.
    """
    neighbourhood = Neighbourhood(scene, surfaces, width, height)
    fixed = [neighbourhood.home]
    if count > 2 * len(BORDER):
        fixed += neighbourhood.border()
    times = [view_time(scene, number) for number in range(count)]
    return ViewSet(fixed, neighbourhood.spread(count - len(fixed), seed), times)


def monocular_views(scene: Scene, surfaces: Surfaces, count: int, width: int, height: int) -> ViewSet:
    """As `choose_views`, of one camera that sways around the scene's own, one instant after the other."""
    shares = np.linspace(0, 1, count)
    cameras = Neighbourhood(scene, surfaces, width, height).path(shares.tolist())
    return ViewSet([], cameras, [0.0 if scene.moving is None else float(share) for share in shares])


def view_time(scene: Scene, number: float) -> float:
    """The time from 0 to 1 that a view shows, by its number; 0 if nothing moves.

    Views to train on have numbers 0, 1, 2 ..., of evenly spread times; validation views 0.5, 1.5 and so on.
    """
    return 0.0 if scene.moving is None else (0.5 + number * _GOLDEN) % 1
