"""Scenes of the tests in another size and at another place, in float64 until they are loaded."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np


def placed(description: dict[str, Any], scale: float = 1.0, offset: float = 0.0) -> dict[str, Any]:
    """A scene scaled, then moved along all axes; its light is the same."""
    return {
        name: _placed(part, scale, offset) if isinstance(part, dict) else part
        for name, part in description.items()
    }


def _placed(part: dict[str, Any], scale: float, offset: float) -> dict[str, Any]:
    part = dict(part)
    if part["type"] == "point":
        part["position"] = [scale * value + offset for value in part["position"]]
        part["intensity"] = {"type": "rgb", "value": part["intensity"]["value"] * scale**2}
    if part["type"] == "sphere" and "to_world" not in part:
        centre, radius = part.pop("center", [0, 0, 0]), part.pop("radius")
        part["to_world"] = mi.ScalarTransform4d().translate(centre).scale(radius)
    if part["type"] == "perspective":
        part |= {"near_clip": 0.01 * scale, "far_clip": 1e4 * scale}
    if "to_world" in part:
        matrix = np.array(part["to_world"].matrix, dtype=np.float64).reshape(4, 4)
        # A camera has no scale.
        matrix[:3, 3 if part["type"] == "perspective" else 0 :] *= scale
        matrix[:3, 3] += offset
        part["to_world"] = mi.ScalarTransform4d(matrix)
    return part
