"""The surroundings of a camera's path as a region, and the file that holds the path.

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

from compose.base.errors import UserError, one_line, reading
from compose.base.files import read_json
from compose.camera.camera import Array, Camera, look_at, turned
from compose.camera.coordinate_systems import camera_from_json, opengl_from_opencv
from pathtrace.region.view_selection import DrawnRegion, Looks, looks_of, upright
from pathtrace.scene.scene import Scene
from pathtrace.scene.triangles import Surfaces

_MOST_BYTES = 1 << 24
# The path is part of what is trained, and goes into its files.
MOST_POSES = 1000
# Cameras as JSON need some.
_ANY_INTRINSICS = {"w": 1, "h": 1, "fl_x": 1.0, "fl_y": 1.0, "cx": 0.5, "cy": 0.5}
# Lengths in units of the median distance to what the cameras of the path see.
_RADIUS = 0.12
_CLEARANCE = 0.01
_NEAR = 0.05
_PATCH = 0.04
# Largest turns away from the path's own looks, yaw and pitch in degrees: of viewers, and to train on.
_TURNS, _TRAINING_TURNS = (20.0, 10.0), (32.0, 16.0)
# Tries for a free point in the surroundings of each point that is drawn on the path.
_BALL_TRIES = 8


def read_path(file: Path, up: Array) -> tuple[list[Array], float | None]:
    """Poses (4, 4) of the path in a file, camera-to-world, OpenCV axes, and the radius that it has, if any.

    All are in the coordinates of the scene's file, in which `up` (3,) is up unless a pose says otherwise.
    UserError if the file holds no path.
    """
    with reading(file):
        document = read_json(file, _MOST_BYTES)
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list) or not frames:
        raise UserError(f"{file}: is not a camera path; must be JSON with a list of poses under frames")
    if len(frames) > MOST_POSES:
        raise UserError(f"{file}: {len(frames):,} frames; must be at most {MOST_POSES:,}")
    radius = document.get("radius")
    is_number = isinstance(radius, int | float) and not isinstance(radius, bool)
    if radius is not None and not (is_number and 0 < radius < np.inf):
        raise UserError(f"{file}: radius is {one_line(repr(radius))}; must be a positive number")
    poses = []
    for index, frame in enumerate(frames):
        try:
            poses.append(_pose(frame, up))
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            what = f"has no {error.args[0]}" if isinstance(error, KeyError) else one_line(error)
            raise UserError(
                f"{file}: frames[{index}] is not a pose ({what}); must have transform_matrix, or position "
                "and look_at"
            ) from error
    return poses, radius


def _pose(frame: object, up: Array) -> Array:
    """(4, 4) camera-to-world of a frame, OpenCV axes."""
    if not isinstance(frame, dict):
        raise ValueError("not an object")
    if "transform_matrix" in frame:
        matrix = frame["transform_matrix"]
        return camera_from_json({**_ANY_INTRINSICS, "transform_matrix": matrix}).camera_to_world
    return look_at(_point(frame, "position"), _point(frame, "look_at"), _point({"up": up, **frame}, "up"))


def _point(frame: dict[str, Any], name: str) -> Array:
    value = np.asarray(frame[name], dtype=np.float64)
    if value.shape != (3,) or not np.isfinite(value).all():
        raise ValueError(f"{name} is not three numbers")
    return value


class PathRegion(DrawnRegion):
    """The space around the camera's path in a file, whose name it has.

    Its radius is an eighth of the distance to what the cameras see, if the file has none. UserError as for
    `read_path`, if a pose lies on a surface, or a surface between two poses, or the path sees no surface.
    """

    _views = "along the path"
    _nothing = "no view along the path sees more than surfaces right before it"

    def __init__(self, scene: Scene, surfaces: Surfaces, file: Path):
        self._scene, self._surfaces = scene, surfaces
        self.name = self._source = str(file)
        self._poses, radius = read_path(file, upright(scene.camera))
        place = scene.place
        self._looks = looks_of([place.camera(scene.camera.at(pose)) for pose in self._poses])
        distance = self._looks.probe(surfaces, scene.camera, 12)
        seen = distance[np.isfinite(distance)]
        if not len(seen):
            raise UserError(f"{file}: no frame of the path sees a surface")
        self._scale = float(np.median(seen))
        self._patch, self._near = _PATCH * self._scale, _NEAR * self._scale
        self.radius = _RADIUS * self._scale if radius is None else radius / place.unit
        self._least = min(_CLEARANCE * self._scale, 0.5 * self.radius)
        stops = self._looks.positions
        tight = np.flatnonzero(surfaces.clearances(stops) < 0.1 * self._least)
        blocked = 1 + np.flatnonzero(~surfaces.are_joined(stops[:-1], stops[1:]))
        if len(tight) and not (len(blocked) and blocked[0] < tight[0]):
            raise UserError(f"{file}: frames[{tight[0]}] lies on a surface; must be in free space")
        if len(blocked):
            raise UserError(
                f"{file}: the path leaves the free space: a surface lies between "
                f"frames[{blocked[0] - 1}] and frames[{blocked[0]}]"
            )

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
        matrices = [opengl_from_opencv(pose).tolist() for pose in self._poses]
        radius = self.radius * self._scene.place.unit
        return {"kind": "path", "radius": radius, "frames": [{"transform_matrix": m} for m in matrices]}

    def _first(self, home: Camera) -> Camera:
        return self._looks.camera(0, home)

    def _propose(self, number: int, for_training: bool, rng: np.random.Generator) -> Looks:
        places, index = self._along(rng.random(number))
        ball = rng.normal(size=(_BALL_TRIES, number, 3))
        ball /= np.linalg.norm(ball, axis=2, keepdims=True)
        ball *= self.radius * rng.random((_BALL_TRIES, number, 1)) ** (1 / 3)
        positions = places.copy()
        for offset in ball[::-1]:
            free = self._is_free(places, places + offset)
            positions[free] = (places + offset)[free]
        limits = _TRAINING_TURNS if for_training else _TURNS
        turns = [limit * (2 * rng.random(number) - 1) for limit in limits]
        rotations = [turned(*one) for one in zip(self._looks.rotations[index], *turns, strict=True)]
        return Looks(positions, np.array(rotations))

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
        clearance = self._surfaces.clearances(points)
        return self._surfaces.are_joined(places, points) & (clearance >= self._least)
