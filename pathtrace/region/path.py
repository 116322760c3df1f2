"""A region given by a file: the surroundings of a camera's path.

The file is JSON with the pose of each frame, in the coordinates of the scene's file:

    {"radius": 0.3, "frames": [
        {"position": [1, 1.6, 0], "look_at": [3, 1.2, 0], "up": [0, 1, 0]},
        {"transform_matrix": [[...], [...], [...], [...]]}]}

A pose is a matrix as in transforms.json (camera-to-world, OpenGL axes), whose files are paths therefore, or a
position, what it looks at, and what is up, which may be left out. `radius` may be left out as well.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError, one_line
from compose.base.json_file import read_json
from compose.camera.axes import opengl_from_opencv
from compose.camera.camera import Array, Camera, look_at
from compose.camera.serialization import camera_from_json, camera_to_json
from compose.camera.turning import turned
from pathtrace.region.drawing import JUDGING, TRAINING, VIEWING, drawn, generator
from pathtrace.region.looks import Looks, looks_of, upright
from pathtrace.region.selection import Selection
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces, sphere_directions

_MOST_BYTES = 1 << 24
# The path is part of what is trained, and goes into its files.
MOST_POSES = 1000
# Lengths in units of the median distance to what the cameras of the path see.
_RADIUS = 0.12
_CLEARANCE = 0.01
_NEAR = 0.05
_PATCH = 0.04
# Largest turns away from the path's own looks: yaw and pitch in degrees, to judge by and to train on.
_TURNS, _TRAINING_TURNS = (20.0, 10.0), (32.0, 16.0)
_DIRECTIONS = 96
# Points of a path whose surroundings are drawn from, and tries for each.
_BALL_TRIES = 8


class PathRegion:
    """The space around a camera's path.

    Args:
        scene: the scene.
        surfaces: its surfaces.
        poses: at least one camera, in the scene's coordinates, with any intrinsics.
        radius: of what belongs to it around the path, in the scene's coordinates; None for an eighth of the
            distance to what its cameras see.
        name: for error messages: of the file.

    Raises:
        UserError: a pose lies on a surface, or a surface lies between it and the pose before; or the path
            sees no surface.
    """

    def __init__(
        self, scene: Scene, surfaces: Surfaces, poses: list[Camera], radius: float | None, name: str
    ):
        self._scene, self._surfaces, self._poses, self.name = scene, surfaces, poses, name
        self._looks = looks_of(poses)
        distance = self._looks.probe(surfaces, scene.camera, 12)
        if not np.isfinite(distance).any():
            raise UserError(f"{name}: no frame of the path sees a surface")
        self._scale = float(np.median(distance[np.isfinite(distance)]))
        self.radius = _RADIUS * self._scale if radius is None else radius
        self._least = min(_CLEARANCE * self._scale, 0.5 * self.radius)
        self._check_free()

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) lie within the radius, and nothing between them and the path."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        finite = np.isfinite(points.sum(axis=1))
        nearest = self._nearest(np.where(finite[:, None], points, 0))
        away = np.linalg.norm(points - nearest, axis=1)
        # Rounding of the pose must not put the path itself outside.
        found = finite & (away <= self.radius * (1 + 1e-6))
        is_path = away[found] <= 1e-6 * self._scale
        found[found] = is_path | self._is_free(nearest[found], points[found])
        return found

    def identity(self) -> dict[str, Any]:
        """What tells it from other regions of the same scene, in the coordinates of the scene's file."""
        place = self._scene.place
        matrices = []
        for pose in self._poses:
            matrix = pose.camera_to_world
            matrix[:3, 3] = place.in_world(matrix[None, :3, 3])[0]
            matrices.append(opengl_from_opencv(matrix).tolist())
        radius = self.radius * place.unit
        return {"kind": "path", "radius": radius, "frames": [{"transform_matrix": m} for m in matrices]}

    def views(self, count: int, width: int, height: int, seed: int) -> list[Camera]:
        """Views to train on: the path's first, then those that show most of what is new."""
        like = self._scene.camera.resized(width, height)
        first = self._looks.camera(0, like)
        viewers = self._draw(Selection.viewers(), like, _TURNS, generator(0, VIEWING))
        patch, origin = _PATCH * self._scale, first.position
        selection = Selection(self._surfaces, patch, origin, (viewers, like))

        def candidates(number: int, round_index: int) -> Looks:
            return self._draw(number, like, _TRAINING_TURNS, generator(seed, TRAINING, round_index))

        return selection.chosen(count, [first], like, candidates)

    def unseen_views(self, count: int, width: int, height: int, seed: int) -> list[Camera]:
        """Views to judge by: anywhere along the path, turned away from its looks by up to 20 degrees."""
        like = self._scene.camera.resized(width, height)
        looks = self._draw(count, like, _TURNS, generator(seed, JUDGING))
        if len(looks) < count:
            raise UserError(f"{self.name}: only {len(looks)} of {count} views along the path show surfaces")
        return [looks.camera(index, like) for index in range(count)]

    def _draw(self, count: int, like: Camera, turns: tuple[float, float], rng: np.random.Generator) -> Looks:
        def propose(number: int) -> Looks:
            places, index = self._along(rng.random(number))
            ball = rng.normal(size=(_BALL_TRIES, number, 3))
            ball /= np.linalg.norm(ball, axis=2, keepdims=True)
            ball *= self.radius * rng.random((_BALL_TRIES, number, 1)) ** (1 / 3)
            positions = places.copy()
            for offset in ball[::-1]:
                free = self._is_free(places, places + offset)
                positions[free] = (places + offset)[free]
            yaw, pitch = (limit * (2 * rng.random(number) - 1) for limit in turns)
            rotations = self._looks.rotations[index]
            turned_ = [turned(r, y, p) for r, y, p in zip(rotations, yaw, pitch, strict=True)]
            return Looks(positions, np.array(turned_))

        found = drawn(count, propose, self._surfaces, like, _NEAR * self._scale)
        if not len(found):
            raise UserError(f"{self.name}: no view along the path sees more than surfaces right before it")
        return found

    def _along(self, share: Array) -> tuple[Array, NDArray[np.int64]]:
        """Points (N, 3) at shares of the path's length, and the poses nearest to each along it."""
        stops = self._looks.positions
        steps = np.linalg.norm(np.diff(stops, axis=0), axis=1)
        if not steps.sum():
            return stops[np.zeros(len(share), dtype=int)], (share * len(stops)).astype(np.int64)
        ends = np.append(0, np.cumsum(steps))
        at = share * ends[-1]
        index = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(steps) - 1)
        part = (at - ends[index]) / np.where(steps[index] > 0, steps[index], 1)
        return stops[index] + part[:, None] * (stops[index + 1] - stops[index]), index + (part > 0.5)

    def _nearest(self, points: Array) -> Array:
        """(N, 3) the path's nearest points to points (N, 3)."""
        stops = self._looks.positions
        nearest = np.repeat(stops[:1], len(points), axis=0)
        least = np.linalg.norm(points - nearest, axis=1)
        for start, end in itertools.pairwise(stops):
            way = end - start
            part = np.clip((points - start) @ way / max(float(way @ way), 1e-300), 0, 1)
            candidate = start + part[:, None] * way
            distance = np.linalg.norm(points - candidate, axis=1)
            nearest = np.where((distance < least)[:, None], candidate, nearest)
            least = np.minimum(distance, least)
        return nearest

    def _is_free(self, places: Array, points: Array) -> NDArray[np.bool_]:
        """Whether points (N, 3) are seen from places (N, 3) and not on a surface."""
        clearance = self._surfaces.clearances(points, sphere_directions(_DIRECTIONS))
        return self._surfaces.are_joined(places, points) & (clearance >= self._least)

    def _check_free(self) -> None:
        stops = self._looks.positions
        clearance = self._surfaces.clearances(stops, sphere_directions(_DIRECTIONS))
        tight = np.flatnonzero(clearance < 0.1 * self._least)
        blocked = 1 + np.flatnonzero(~self._surfaces.are_joined(stops[:-1], stops[1:]))
        if len(tight) and not (len(blocked) and blocked[0] < tight[0]):
            raise UserError(f"{self.name}: frames[{tight[0]}] lies on a surface; must be in free space")
        if len(blocked):
            raise UserError(
                f"{self.name}: the path leaves the free space: a surface lies between "
                f"frames[{blocked[0] - 1}] and frames[{blocked[0]}]"
            )


def path_region(scene: Scene, surfaces: Surfaces, file: Path) -> PathRegion:
    """The region of a path's file.

    Raises:
        UserError: the file cannot be read or is no path, or as of `PathRegion`.
    """
    try:
        document = read_json(file, _MOST_BYTES)
    except (OSError, ValueError) as error:
        raise UserError(f"{file}: cannot be read ({one_line(error)})") from error
    return region_of_path(scene, surfaces, document, str(file))


def region_of_path(scene: Scene, surfaces: Surfaces, document: Any, name: str) -> PathRegion:
    """The region of a path's JSON; `name` is for error messages."""
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list) or not frames:
        raise UserError(f"{name}: is no camera path; must be JSON with a list of poses under frames")
    if len(frames) > MOST_POSES:
        raise UserError(f"{name}: {len(frames):,} frames; must be at most {MOST_POSES:,}")
    radius = document.get("radius")
    if radius is not None:
        if isinstance(radius, bool) or not isinstance(radius, int | float) or not 0 < radius < np.inf:
            raise UserError(f"{name}: radius is {one_line(repr(radius))}; must be a positive number")
        radius = radius / scene.place.unit
    poses = []
    for index, frame in enumerate(frames):
        try:
            poses.append(_pose(scene, frame))
        except (KeyError, TypeError, ValueError) as error:
            lacking = "has no " if isinstance(error, KeyError) else ""
            what = str(error.args[0]) if lacking else one_line(error)
            raise UserError(
                f"{name}: frames[{index}] is no pose ({lacking}{what}); must have transform_matrix, or "
                "position and look_at"
            ) from error
    return PathRegion(scene, surfaces, poses, radius, name)


def _pose(scene: Scene, frame: Any) -> Camera:
    """A pose of a path as a camera with the scene's own intrinsics, in the scene's coordinates."""
    if not isinstance(frame, dict):
        raise ValueError("not an object")
    if "transform_matrix" in frame:
        matrix = frame["transform_matrix"]
    else:
        up = _point(frame, "up") if "up" in frame else upright(scene.camera)
        matrix = opengl_from_opencv(look_at(_point(frame, "position"), _point(frame, "look_at"), up)).tolist()
    return scene.place.camera(camera_from_json({**camera_to_json(scene.camera), "transform_matrix": matrix}))


def _point(frame: dict[str, Any], name: str) -> Array:
    """(3,) numbers of a frame."""
    value = np.asarray(frame[name], dtype=np.float64)
    if value.shape != (3,) or not np.isfinite(value).all():
        raise ValueError(f"{name} is not three numbers")
    return value
