"""Cameras of a scene, what they see besides surfaces and their light, and what keeps that from converging."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera, camera_from_pose
from compose.camera.coordinate_systems import opencv_from_mitsuba
from pathtrace.scene.instances import seen_shapes
from pathtrace.scene.panes import pane_shapes
from pathtrace.scene.triangles import triangles_of

if TYPE_CHECKING:
    from pathtrace.scene.scene import Scene

# Clipping planes that Mitsuba's cameras have by default.
_NEAR_CLIP, _FAR_CLIP = 0.01, 1e4
# Mean optical depth of a medium that matters.
_LEAST_DEPTH = 0.05
# Side of the coarse frame, in pixels, whose rays tell whether something is cut off.
_PROBE = 24
# Area, as a share of the square of the scene's size, below which a light is tiny: scattered rays hardly ever
# hit it. Share of the light of all area lights from which that of tiny ones counts.
_TINY, _MUCH = 1e-3, 0.3
# Roughness (alpha) up to which a glossy surface focuses light.
_NARROW = 0.15
_NAMED = 3


@dataclass(frozen=True)
class Optics:
    """How cameras see a scene."""

    hides_emitters: bool = False  # whether area lights and the sky are hidden from them, but not their light
    # Depths of clipping planes in the scene's unit; None if they cut nothing off.
    clips: tuple[float, float] | None = None
    # The participating medium in which cameras are, of Mitsuba; None if they are in none.
    medium: mi.Medium | None = None
    # Whether there are participating media that matter, which `volpath` traces, and no cache stands for.
    has_media: bool = False

    @staticmethod
    def of(scene: mi.Scene, sensor: mi.Sensor, camera: Camera, hides_emitters: bool) -> Optics:
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


def clipping_planes(scene: mi.Scene, sensor: mi.Sensor, camera: Camera) -> tuple[float, float] | None:
    """Depths of a sensor's clipping planes, if they cut something off the scene.

    The near one does if the sensor's own camera sees something in front of it. Mitsuba's default planes count
    as none: scenes of any size are seen whole.
    """
    near, far = (float(mi.traverse(sensor)[name]) for name in ("near_clip", "far_clip"))
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


def camera_of_sensor(sensor: mi.Sensor, source: str) -> Camera:
    """The camera of a sensor, in its film's crop window; UserError if its to_world mirrors or shears."""
    parameters, film = mi.traverse(sensor), sensor.film()
    width, height = (int(v) for v in film.size())
    focal = 0.5 * width / np.tan(np.radians(float(parameters["x_fov"][0])) / 2)
    names = [f"principal_point_offset_{axis}" for axis in "xy"]
    # A thin lens has none.
    offset = [float(parameters[name][0]) if name in parameters else 0.0 for name in names]
    to_world = np.array(sensor.world_transform().matrix, dtype=np.float64).reshape(4, 4)
    centre = width * (0.5 - offset[0]), height * (0.5 - offset[1])
    left, top = (int(v) for v in film.crop_offset())
    try:
        whole = camera_from_pose(opencv_from_mitsuba(to_world), width, height, focal, focal, *centre)
        return whole.cropped(left, top, *(int(v) for v in film.crop_size()))
    except ValueError as error:
        raise UserError(f"{source}: the camera's to_world: {error}") from error


def perspective_sensor(scene: mi.Scene, source: str, name: str | None = None) -> mi.Sensor:
    """The perspective sensor or thin lens of a name, by default the first; UserError if there is none."""
    sensors = scene.sensors()
    if not sensors:
        raise UserError(f"{source}: the scene has no camera; add a <sensor type='perspective'>")
    found = [sensor for sensor in sensors if "x_fov" in mi.traverse(sensor)]
    if not found:
        raise UserError(f"{source}: the camera is not a perspective one; use <sensor type='perspective'>")
    named = [sensor for sensor in found if name in (None, sensor.id())]
    if not named:
        names = ", ".join(sensor.id() for sensor in found)
        raise UserError(f"{source}: sensor {name}: the scene's perspective cameras are {names}")
    return named[0]


def _matters(shape: mi.Shape) -> bool:
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


@dataclass(frozen=True)
class Difficulty:
    """A cause of noise, "panes" or "caustics": names of the BSDFs or shapes, and a remedy in words."""

    kind: str
    causes: tuple[str, ...]
    remedy: str

    def __str__(self) -> str:
        """One line for the user."""
        more = f" and {len(self.causes) - _NAMED} more" if len(self.causes) > _NAMED else ""
        return f"{self.kind} ({', '.join(self.causes[:_NAMED])}{more}): {self.remedy}"


def light_difficulties(scene: Scene) -> list[Difficulty]:
    """Causes by which light of a scene may converge slowly, found from its description, without tracing."""
    found = []
    panes = [] if scene.thin_glass else pane_shapes(scene.mitsuba)
    if panes:
        remedy = "no shadow ray passes panes of glass; thin_glass lets them pass"
        found.append(Difficulty("panes", _names(panes), remedy))
    shapes = [shape for shape in seen_shapes(scene.mitsuba) if not shape.is_emitter() and shape not in panes]
    smooth = [shape for shape in shapes if _focuses(shape)]
    if smooth and _sends_narrow_light(scene.mitsuba):
        remedy = (
            "smooth surfaces focus light of a small source, which is found by chance; more samples show it, "
            "most_indirect bounds it"
        )
        found.append(Difficulty("caustics", _names(smooth), remedy))
    return found


def _focuses(shape: mi.Shape) -> bool:
    """Whether a shape has a mirror, clear glass or nearly such a surface, a layer of it included."""
    flags, kinds = int(shape.bsdf().flags()), mi.BSDFFlags
    if flags & int(kinds.DeltaReflection | kinds.DeltaTransmission):
        return True
    if not flags & int(kinds.GlossyReflection | kinds.GlossyTransmission):
        return False
    parameters = mi.traverse(shape.bsdf())
    widths = [
        float(np.mean(np.array(parameters[name])))
        for name in parameters.keys()  # noqa: SIM118
        if name.endswith(("alpha", "alpha.value", "alpha_u.value"))
    ]
    return bool(widths) and min(widths) <= _NARROW


def _sends_narrow_light(scene: mi.Scene) -> bool:
    """Whether much of the light is that of a sun, or of area lights that are tiny for the scene."""
    size = float(np.linalg.norm(np.array(scene.bbox().extents())))
    tiny, total = 0.0, 0.0
    for emitter in scene.emitters():
        if "sky" in str(emitter).lower().partition("[")[0]:
            return True
        if (shape := emitter.get_shape()) is not None:
            area, parameters = float(shape.surface_area()[0]), mi.traverse(emitter)
            # Textures count as 1.
            power = area * float(np.mean(parameters.get("radiance.value", 1.0)))
            total += power
            tiny += power if area < _TINY * size**2 else 0.0
    return tiny > _MUCH * total


def _names(shapes: list[mi.Shape]) -> tuple[str, ...]:
    """Names of the BSDFs of shapes: meshes of one BSDF are merged, and lose theirs."""
    return tuple(sorted({shape.bsdf().id() or shape.bsdf().class_name() for shape in shapes}))
