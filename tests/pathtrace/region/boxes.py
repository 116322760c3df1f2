"""Boxes to walk in: two rooms with a gap between them, a pipe, a plane under the sky."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from tests import small


def camera(origin: list[float], target: list[float], fov: float = 60.0) -> dict[str, Any]:
    look = mi.ScalarTransform4f().look_at(origin=origin, target=target, up=[0, 1, 0])
    return {**small.sensor(32, 32, fov), "to_world": look}


def shell(x: float, y: float, z: float) -> dict[str, Any]:
    """A closed box around the origin with half sides x, y, z."""
    return {"type": "cube", "to_world": mi.ScalarTransform4f().scale([x, y, z])}


def lamp(position: list[float]) -> dict[str, Any]:
    return {"type": "point", "position": position, "intensity": {"type": "rgb", "value": 8.0}}


def _wall(start: float, end: float) -> dict[str, Any]:
    """A wall at x = 1 from z = start to z = end."""
    placed = mi.ScalarTransform4f().translate([1, 0, (start + end) / 2])
    return {
        "type": "rectangle",
        "to_world": placed.rotate([0, 1, 0], 90).scale([(end - start) / 2, 1.5, 1]),
    }


def rooms(gap: float, x: float = -2.0) -> dict[str, Any]:
    """Rooms from x = -4 to 1 and from 1 to 4, 3 high and 4 deep, with a slit between them, up to the top.

    The camera is in the larger one, at x, and looks at the slit.
    """
    return {
        "type": "scene",
        "sensor": camera([x, 0, 0], [x + 2, 0, 0]),
        "shell": shell(4, 1.5, 2),
        "left": _wall(-2, -gap / 2),
        "right": _wall(gap / 2, 2),
        "lamp": lamp([-2, 1, 0]),
    }


def pipe() -> dict[str, Any]:
    """A camera amid a pipe of 0.06 by 0.06 by 6, through whose end it sees the wall of a hall."""
    sides = {
        f"side{number}": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().translate([x, y, 0]).scale([0.05, 0.05, 3]),
        }
        for number, (x, y) in enumerate([(-0.08, 0), (0.08, 0), (0, -0.08), (0, 0.08)])
    }
    return {
        "type": "scene",
        "sensor": camera([0, 0, 0], [0, 0, 1], 0.5),
        "shell": shell(5, 5, 16),
        "lamp": lamp([2, 0, 8]),
        **sides,
    }


def plain() -> dict[str, Any]:
    """A camera 1.6 above a plane of 100 by 100, under nothing."""
    ground = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(50)
    return {
        "type": "scene",
        "sensor": camera([0, 1.6, 0], [0, 0.8, 4]),
        "ground": {"type": "rectangle", "to_world": ground},
        "lamp": lamp([0, 9, 0]),
    }
