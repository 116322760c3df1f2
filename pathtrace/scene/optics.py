"""What cameras of a scene see besides its surfaces and their light: clipping planes, hidden lights, media."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from compose.camera.camera import Camera
from pathtrace.scene.instances import seen_shapes
from pathtrace.scene.triangles import triangles_of

# Clipping planes that Mitsuba's cameras have by default.
_NEAR_CLIP, _FAR_CLIP = 0.01, 1e4
# Mean optical depth of a medium that matters.
_LEAST_DEPTH = 0.05
# Side of the coarse frame, in pixels, whose rays tell whether something is cut off.
_PROBE = 24


@dataclass(frozen=True)
class Optics:
    """How cameras see a scene.

    Attributes:
        hides_emitters: whether area lights and the sky are hidden from them, but not their light.
        clips: depths of clipping planes in the scene's unit; None if they cut nothing off.
        medium: the participating medium in which cameras are, of Mitsuba; None if they are in none.
        has_media: whether there are participating media that matter, which `volpath` traces, and no cache
            stands for.
    """

    hides_emitters: bool = False
    clips: tuple[float, float] | None = None
    medium: Any = None
    has_media: bool = False

    @staticmethod
    def of(scene: Any, sensor: Any, camera: Camera, hides_emitters: bool) -> Optics:
        """Those of a Mitsuba scene with a sensor, whose camera is given as well."""
        medium = sensor.get_medium()
        has_media = medium is not None or any(
            shape.is_medium_transition() and _matters(shape) for shape in seen_shapes(scene)
        )
        return Optics(hides_emitters, clipping_planes(scene, sensor, camera), medium, has_media)

    @property
    def text(self) -> str:
        """What fingerprints cover, empty if all is as in most scenes."""
        seen = f" hides {self.hides_emitters} clips {self.clips} media {self.has_media}"
        return "" if self == Optics() else seen


def clipping_planes(scene: Any, sensor: Any, camera: Camera) -> tuple[float, float] | None:
    """Depths of a sensor's clipping planes, if its file has any that cut something off the scene.

    The near one does if the sensor's own camera sees something in front of it. Mitsuba's own planes, which
    sensors have by default, count as none: scenes of any size are seen whole.
    """
    near, far = float(sensor.near_clip()), float(sensor.far_clip())
    if near == np.float32(_NEAR_CLIP) and far == np.float32(_FAR_CLIP):
        return None
    box, forward = scene.bbox(), camera.camera_to_world[:3, 2]
    corners = np.array(np.meshgrid(*zip(box.min, box.max, strict=True))).reshape(3, -1).T
    if far < np.max((corners - camera.position) @ forward):
        return near, far
    small = camera.resized(_PROBE, _PROBE)
    ways = small.rays(small.pixel_centres())
    # Of length 1 in depth.
    ways = (ways / (ways @ forward)[:, None]).T.astype(np.float32)
    rays = mi.Ray3f(mi.Point3f(camera.position), mi.Vector3f(ways))
    depth = scene.ray_intersect_preliminary(rays).t.numpy()
    return (near, far) if (depth < near).any() else None


def _matters(shape: Any) -> bool:
    """Whether the medium of a shape takes a noticeable share of light; tinted glass often does not."""
    medium = shape.interior_medium()
    if shape.exterior_medium() is not None or medium.class_name() != "HomogeneousMedium":
        return True
    parameters = mi.traverse(medium)
    densest = max(np.max(np.array(value)) for key, value in parameters.items() if key.startswith("sigma_t"))
    box = shape.bbox().extents()
    volume, area = dr.prod(box), 2 * (box.x * box.y + box.y * box.z + box.z * box.x)
    if (triangles := triangles_of(shape)) is not None:
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        volume = abs(np.sum(triangles[:, 0] * normals)) / 6
        area = np.linalg.norm(normals, axis=1).sum() / 2
    # Mean chord of a convex body (Cauchy).
    return bool(parameters["scale"] * densest * 4 * volume > _LEAST_DEPTH * area)
