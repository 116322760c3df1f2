"""Moves and scales a scene that Mitsuba has parsed, before it is loaded and its numbers become float32."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from compose.camera.camera import Array
from compose.camera.place import Place
from pathtrace.scene.sunsky import PLUGIN as BALANCED_SUNSKY

# What scales with its to_world alone; for other plugins, another unit of length would change how they look.
_SHAPES = ("obj", "ply", "serialized", "cube", "rectangle", "disk", "sphere", "cylinder", "instance")
_POINTS = ("point", "spot")
_ENDLESS = ("constant", "envmap", "directional", "sunsky", "sun", "sky", BALANCED_SUNSKY)
# Where float32 has this many steps to a power of two.
_STEPS = 2.0**23


class ImmovableError(ValueError):
    """A scene has a part that cannot be moved or scaled; says which."""


def camera_position(state: Any) -> Array:
    """(3,) position in world space, float64, of the first camera of a parsed scene."""
    for node in state.nodes:
        if node.type == mi.ObjectType.Sensor:
            return _to_world(node.props)[:3, 3]
    return np.zeros(3)


def relocate(state: Any, place: Place) -> None:
    """Puts a parsed scene into the coordinates of a place.

    Light stays as it is: that of area lights does not depend on the unit of length, and the intensity of
    point lights is divided by its square.

    Raises:
        ImmovableError: of a part of the scene.
    """
    inside = {
        index
        for node in state.nodes
        if node.props.plugin_name() == "shapegroup"
        for index in _references(node.props)
    }
    for index, node in enumerate(state.nodes):
        kind, plugin = node.type, node.props.plugin_name()
        if kind in (mi.ObjectType.Medium, mi.ObjectType.Volume) or _holds_objects(node.props):
            raise ImmovableError(f"a {plugin or 'loaded object'}")
        if kind == mi.ObjectType.BSDF and plugin == "bumpmap" and place.unit != 1:
            raise ImmovableError("a bumpmap")
        moved = kind in (mi.ObjectType.Sensor, mi.ObjectType.Shape, mi.ObjectType.Emitter)
        if index in inside or plugin == "shapegroup" or not moved:
            continue
        if kind == mi.ObjectType.Shape and plugin not in _SHAPES:
            raise ImmovableError(f"a {plugin}")
        if kind == mi.ObjectType.Emitter:
            _relocate_emitter(node.props, place)
        else:
            _relocate_to_world(node.props, place)


def coarsest_step(state: Any) -> float:
    """Step of float32 at the vertices of a scene's mesh files: if they carry the distance from the origin.

    A mesh that its to_world puts near the camera has its vertices near its own origin.
    """
    camera = camera_position(state)
    far = float(np.linalg.norm(camera))
    files = (
        node.props for node in state.nodes if node.type == mi.ObjectType.Shape and "filename" in node.props
    )
    unmoved = any(np.linalg.norm(_to_world(file)[:3, 3] - camera) > 0.5 * far for file in files)
    return far / _STEPS if unmoved else 0.0


def _relocate_emitter(properties: Any, place: Place) -> None:
    plugin = properties.plugin_name()
    if plugin == "area" or plugin in _ENDLESS:
        return
    if plugin not in _POINTS:
        raise ImmovableError(f"a {plugin}")
    if place.unit != 1:
        _scale_intensity(properties, place.unit**-2)
    if "position" in properties:
        moved = (np.array(properties["position"], dtype=np.float64) - place.origin) / place.unit
        properties["position"] = moved.tolist()
    else:
        _relocate_to_world(properties, place)


def _scale_intensity(properties: Any, factor: float) -> None:
    """Scales the intensity of a point light."""
    if "intensity" not in properties:
        properties["intensity"] = factor
        return
    intensity = properties["intensity"]
    kind = properties.type("intensity")
    if kind == mi.Properties.Type.Float:
        properties["intensity"] = float(intensity) * factor
    elif kind == mi.Properties.Type.Color:
        properties["intensity"] = mi.ScalarColor3d(*(float(channel) * factor for channel in intensity))
    else:
        raise ImmovableError(f"a {properties.plugin_name()} light with a spectrum or a texture")


def _relocate_to_world(properties: Any, place: Place) -> None:
    matrix = _to_world(properties)
    matrix[:3] /= place.unit
    matrix[:3, 3] -= np.array(place.origin) / place.unit
    if properties.plugin_name() in ("perspective", "thinlens"):
        # A camera has no scale.
        matrix[:3, :3] *= place.unit
        for clip in ("near_clip", "far_clip"):
            if clip in properties:
                properties[clip] = float(properties[clip]) / place.unit
    properties["to_world"] = mi.ScalarTransform4d(matrix)


def _to_world(properties: Any) -> Array:
    """(4, 4) float64; a copy."""
    if "to_world" not in properties:
        return np.eye(4)
    return np.array(properties["to_world"].matrix, dtype=np.float64).reshape(4, 4)


def _references(properties: Any) -> list[int]:
    """Indices of the nodes that a node holds."""
    kind = mi.Properties.Type.ResolvedReference
    return [properties[name].index() for name in properties.keys() if properties.type(name) == kind]  # noqa: SIM118


def _holds_objects(properties: Any) -> bool:
    """Whether a node holds an object that is loaded already, as dictionaries may."""
    kind = mi.Properties.Type.Object
    return any(properties.type(name) == kind for name in properties.keys())  # noqa: SIM118
