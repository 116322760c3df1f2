"""Lights of a glTF file (extension KHR_lights_punctual), and its camera (specification, 3.10)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any

import numpy as np

from compose.camera.camera import Array
from compose.camera.coordinate_systems import mitsuba_from_opencv, opencv_from_opengl
from pathtrace.gltf.animated_nodes import Nodes
from pathtrace.gltf.document import Document
from pathtrace.gltf.materials import plugin, to_world, value
from pathtrace.gltf.movement import without_scale

_EXTENSION = "KHR_lights_punctual"
# Irradiance by which a white wall is white in a picture, and how much more counts as too bright.
_WHITE, _TOO_BRIGHT = np.pi, 10.0
_HEIGHT, _MOST_ASPECT = 512, 8.0
# Largest angle from a spot's axis, rounded up, and largest inner angle over the outer one.
_WIDEST, _SHARPEST = np.pi / 2 + 1e-6, 0.999
# Of a camera that is made up, degrees.
_FOV = 45.0


@dataclass(frozen=True)
class Light:
    """A light, point, spot or directional, which shines along the negative z of its node."""

    node: int
    kind: str
    colour: Array  # (3,) times intensity: candela, or lux of a directional light
    cone: tuple[float, float]  # of a spot: inner and outer angle in degrees from its axis

    def element(self, name: str, pose: Array, scale: float) -> ET.Element:
        """The emitter, where its node is (4, 4), and so many times as bright."""
        colour = self.colour * scale
        if self.kind == "point":
            x, y, z = (f"{v:.9g}" for v in pose[:3, 3])
            position = ET.Element("point", {"name": "position", "x": x, "y": y, "z": z})
            return plugin("emitter", "point", position, value("rgb", "intensity", colour), id=name)
        placed = to_world(_mitsuba_pose(pose))
        if self.kind == "directional":
            return plugin("emitter", "directional", placed, value("rgb", "irradiance", colour), id=name)
        inner, outer = self.cone
        cone = value("float", "cutoff_angle", outer), value("float", "beam_width", inner)
        return plugin("emitter", "spot", placed, value("rgb", "intensity", colour), *cone, id=name)

    def irradiance(self, pose: Array, bounds: Array) -> float:
        """What it gives, at most, in the middle of what is within bounds (2, 3)."""
        if self.kind == "directional":
            return float(self.colour.max())
        distance = np.linalg.norm(pose[:3, 3] - bounds.mean(axis=0))
        # Nothing is nearer to a light in the middle than that.
        least = 0.1 * np.linalg.norm(bounds[1] - bounds[0])
        return float(self.colour.max() / max(distance, least, 1e-9) ** 2)


def read_lights(document: Document, nodes: Nodes) -> list[Light]:
    """The lights of the nodes that are shown; UserError if one is damaged, or of an unknown kind."""
    found = []
    items = document.tree.get("extensions", {}).get(_EXTENSION, {}).get("lights", [])
    for node in nodes.shown:
        reference = document.section("nodes")[node].get("extensions", {}).get(_EXTENSION)
        if reference is None:
            continue
        number = reference.get("light")
        if not isinstance(number, int) or not 0 <= number < len(items):
            raise document.refused(f"nodes[{node}] has the light {number}; there are {len(items)}")
        item, user = items[number], f"lights[{number}]"
        kind, spot = item.get("type"), item.get("spot") or {}
        if kind not in ("point", "spot", "directional"):
            raise document.refused(f"{user} is of the type {kind}; must be point, spot or directional")
        colour = np.array(item.get("color", [1, 1, 1]), dtype=np.float64)
        intensity = float(item.get("intensity", 1.0))
        inner, outer = float(spot.get("innerConeAngle", 0.0)), float(spot.get("outerConeAngle", np.pi / 4))
        is_cone = kind != "spot" or (inner >= 0 and 0 < outer <= _WIDEST)
        if colour.shape != (3,) or min(colour.min(), intensity) < 0 or not is_cone:
            raise document.refused(f"{user} has a colour, intensity or cone that no light has")
        # In float32, a quarter turn is a little more; and Mitsuba's light must have an edge.
        outer = min(outer, np.pi / 2)
        cone = float(np.degrees(min(inner, _SHARPEST * outer))), float(np.degrees(outer))
        found.append(Light(node, kind, colour * intensity, cone))
    return found


def brightness(lights: list[Light], to_world_of: list[Array], bounds: Array) -> float:
    """Factor on all lights, so that those far brighter than white in the middle of the scene can be shown."""
    given = sum(light.irradiance(to_world_of[light.node][0], bounds) for light in lights)
    return _WHITE / given if given > _TOO_BRIGHT * _WHITE else 1.0


def camera(
    document: Document, nodes: Nodes, to_world_of: list[Array], bounds: Array, remarks: list[str]
) -> ET.Element:
    """The first perspective camera of a file, else one that sees everything from the front; adds remarks.

    Given are (T, 4, 4) to_world of each node, the first at time 0, and (2, 3) corners of what is seen.
    """
    for node in nodes.shown:
        item = document.section("nodes")[node]
        if "camera" in item:
            found = document.item("cameras", item["camera"], f"nodes[{node}]")
            if "perspective" in found:
                if len(to_world_of[node]) > 1:
                    remarks.append("the camera moves; the scene's own camera is where it is at the start")
                pose = without_scale(to_world_of[node][:1])[0]
                return _sensor(pose, found["perspective"], bounds)
            remarks.append(f"nodes[{node}] has a camera that is not a perspective one, and is left out")
    # The front of a model is what is seen from +z (3.4).
    radius = max(float(np.linalg.norm(bounds[1] - bounds[0])) / 2, 1e-6)
    pose = np.eye(4)
    pose[:3, 3] = bounds.mean(axis=0)
    pose[2, 3] += radius / np.sin(np.radians(_FOV) / 2)
    return _sensor(pose, {"yfov": np.radians(_FOV), "aspectRatio": 1.0}, bounds)


def _sensor(pose: Array, lens: dict[str, Any], bounds: Array) -> ET.Element:
    away = float(np.linalg.norm(bounds - pose[:3, 3], axis=1).max())
    near, far = min(float(lens.get("znear", np.inf)), 1e-3 * away), 100 * away
    width = round(_HEIGHT * np.clip(lens.get("aspectRatio", 4 / 3), 1 / _MOST_ASPECT, _MOST_ASPECT))
    size = value("integer", "width", str(width)), value("integer", "height", str(_HEIGHT))
    film = plugin("film", "hdrfilm", *size, plugin("rfilter", "box"))
    fov = value("string", "fov_axis", "y"), value("float", "fov", float(np.degrees(lens["yfov"])))
    clips = value("float", "near_clip", near), value("float", "far_clip", far)
    parts = *fov, *clips, to_world(_mitsuba_pose(pose)), film
    return plugin("sensor", "perspective", *parts, id="camera")


def _mitsuba_pose(pose: Array) -> Array:
    """(4, 4) to_world of what looks along negative z, as Mitsuba has it: along positive z."""
    return mitsuba_from_opencv(opencv_from_opengl(pose))
