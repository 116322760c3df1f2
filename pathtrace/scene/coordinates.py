"""Chooses the coordinates of a scene: those of its file, or its own where Mitsuba would spoil it.

Mitsuba starts rays off the surfaces by 9e-5 (1 + |p|) at a point p, and holds vertices in float32. So a room
of a millimetre, and one that is a thousand rooms away from the origin, leak light and lose their shadows.
Measured on a corner of a room, 2.5 units from its camera, at equal seeds: scaled by 0.1, 0.01, 1e-3 and 1e-4,
its picture is 62, 49, 38 and 26 dB from the unscaled one, moved by 10, 100, 1e3 and 1e4 as much, moved by 1e6
22 dB; scaled by 10 to 1e6, 89 dB. In coordinates of their own, all of them come to 89 dB and more.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.camera.place import TYPICAL_DISTANCE, WORLD, Place
from pathtrace.scene.loading import Source, load_mitsuba_in_place
from pathtrace.scene.sensor import camera_of_sensor
from pathtrace.scene.surfaces import Surfaces

# Mitsuba's RayEpsilon in float32.
_RAY_OFFSET = 1500 * 2.0**-24
# Largest offset, and largest step of float32 at a vertex, as shares of how far away surfaces are.
_TOLERANCE = 1e-3
# A scene of at least this size whose camera is no farther from the origin is good as it is.
_ORDINARY_SIZE, _ORDINARY_DISTANCE = 1.0, 20.0


def in_good_coordinates(
    source: Source, loaded: Any, camera: Camera, apart: Collection[str] = ()
) -> tuple[Any, Camera, Place]:
    """A scene in coordinates in which Mitsuba can trace it, with its camera and its place.

    Args:
        source: what it was loaded from.
        loaded: the Mitsuba scene in the coordinates of its file.
        camera: its own.
        apart: ids of shapes that are not to be merged with others.

    Raises:
        UserError: the scene cannot be moved or scaled as far as it would have to be.
    """
    if _is_ordinary(loaded, camera):
        return loaded, camera, WORLD
    unit = 1.0
    while True:
        moved, place, step = load_mitsuba_in_place(source, unit, apart)
        own = camera_of_sensor(moved.sensors()[0], source.name)
        distance = _distance(moved, own)
        if not 0 < distance < np.inf:
            # It sees nothing: whoever needs surfaces says so.
            return loaded, camera, WORLD
        if step > _TOLERANCE * distance * unit:
            far, seen = np.linalg.norm(place.origin), distance * unit
            raise UserError(
                f"{source.name}: meshes have vertices {far:.3g} from the origin, where float32 has steps "
                f"of {step:.2g}, too coarse for what the camera sees {seen:.3g} away; keep vertices near the "
                "origin and place meshes by to_world"
            )
        if unit != 1 or distance >= _RAY_OFFSET / _TOLERANCE:
            return moved, own, place
        # A power of two: scaling by it is exact.
        unit = float(2.0 ** np.round(np.log2(distance / TYPICAL_DISTANCE)))


def fingerprint_in(place: Place, fingerprint: str) -> str:
    """Hash of a scene in the coordinates of a place: forests and frames of others do not fit to it."""
    if place == WORLD:
        return fingerprint
    return hashlib.sha256(f"{fingerprint} at {place.origin} in {place.unit}".encode()).hexdigest()


def _is_ordinary(loaded: Any, camera: Camera) -> bool:
    """Whether rays start near enough to surfaces in the coordinates of the file."""
    far = float(np.linalg.norm(camera.position))
    box = loaded.bbox()
    size = float(np.max(np.array(box.max) - np.array(box.min)))
    if size >= _ORDINARY_SIZE and far <= _ORDINARY_DISTANCE:
        return True
    distance = _distance(loaded, camera)
    if not np.isfinite(distance) and far <= _ORDINARY_DISTANCE:
        return True
    return _RAY_OFFSET * (1 + far) <= _TOLERANCE * distance < np.inf


def _distance(loaded: Any, camera: Camera) -> float:
    return Surfaces(_Loaded(loaded)).median_distance(camera)


@dataclass(frozen=True)
class _Loaded:
    mitsuba: Any
