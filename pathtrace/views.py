"""Chooses training views: in free space, joined to the scene's own camera, at a sane distance."""

from __future__ import annotations

import numpy as np

from compose.errors import UserError
from compose.view import Array, Camera, from_camera_to_world
from pathtrace.scene import Scene
from pathtrace.surface import Surfaces

# All lengths are in units of the median distance that the scene's own camera sees, so that a scene
# in millimetres and one in metres get the same views.
_REACH = 0.12  # how far views lie from the scene's own camera
_CLEARANCE = 0.02  # no surface nearer to the camera than this
_NEAR = 0.15  # what counts as too near to look at
_NEAR_SHARE = 0.1  # share of the frame that may be nearer
_YAW, _PITCH = 20.0, 10.0  # degrees, one side
_PROBE = 24  # rays per side of the probing frame
_TRIES_PER_VIEW = 200


def choose_views(
    scene: Scene, surfaces: Surfaces, count: int, width: int, height: int, seed: int
) -> list[Camera]:
    """Views around the scene's own camera; the first one is that camera itself.

    Args:
        scene, surfaces: the scene and its Embree tree.
        count: how many.
        width, height: frame size in pixels.
        seed: same seed, same views.

    Raises:
        UserError: the scene leaves no room for that many views.
    """
    rng = np.random.default_rng(seed)
    home = scene.camera.resized(width, height)
    scale = _median_distance(home, surfaces)
    if not np.isfinite(scale):
        raise UserError(f"{scene.name}: the scene's own camera sees no surface")
    views = [home]
    for _ in range(count * _TRIES_PER_VIEW):
        if len(views) == count:
            return views
        candidate = _perturb(home, scale, rng)
        if _is_sane(candidate, home, scale, surfaces):
            views.append(candidate)
    if len(views) < count:
        raise UserError(
            f"{scene.name}: only {len(views)} of {count} views fit into the free space around the scene's "
            "camera; ask for fewer with --views"
        )
    return views


def _perturb(home: Camera, scale: float, rng: np.random.Generator) -> Camera:
    pose = home.camera_to_world
    direction = rng.normal(size=3)
    offset = direction / np.linalg.norm(direction) * rng.uniform() ** (1 / 3) * _REACH * scale
    yaw, pitch = rng.uniform(-1, 1, 2) * np.radians([_YAW, _PITCH])
    # Yaw about the camera's own upward axis keeps the horizon; pitch about its x axis follows.
    turn_yaw = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    turn_pitch = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    moved = np.eye(4)
    moved[:3, :3] = pose[:3, :3] @ turn_yaw @ turn_pitch
    moved[:3, 3] = pose[:3, 3] + offset
    return from_camera_to_world(moved, home.width, home.height, home.fx, home.fy, home.cx, home.cy)


def _probe(camera: Camera, surfaces: Surfaces) -> Array:
    small = camera.resized(_PROBE, _PROBE)
    directions = small.rays(small.pixel_centres())
    return surfaces.distance(np.repeat(camera.position[None], len(directions), axis=0), directions)


def _median_distance(camera: Camera, surfaces: Surfaces) -> float:
    distance = _probe(camera, surfaces)
    seen = distance[np.isfinite(distance)]
    return float(np.median(seen)) if len(seen) else np.inf


def _is_sane(candidate: Camera, home: Camera, scale: float, surfaces: Surfaces) -> bool:
    if not surfaces.sees(home.position, candidate.position):
        return False
    if surfaces.clearance(candidate.position) < _CLEARANCE * scale:
        return False
    distance = _probe(candidate, surfaces)
    return float(np.mean(distance < _NEAR * scale)) <= _NEAR_SHARE
