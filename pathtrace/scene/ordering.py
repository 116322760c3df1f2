"""A deterministic order of a scene's shapes."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np


def with_ordered_shapes(scene: Any) -> tuple[Any, dict[str, str]]:
    """The same Mitsuba scene with its shapes sorted by bounding box and number of primitives.

    Returns:
        The scene, and the ids that its shapes, and lights that are none, have in it by those that they had.

    Where Mitsuba merges meshes, the order of the merged meshes, and of the lights among them, differs each
    time a scene is loaded: the same random number would choose another light, and the same seed give other
    noise. Scenes with instances keep the order in which they were loaded.
    """
    if any(shape.class_name() == "Instance" for shape in scene.shapes()):
        # Instances cannot leave the scene that holds what they repeat.
        return scene, {part.id(): part.id() for part in (*scene.shapes(), *scene.emitters())}
    parts = {f"sensor_{number}": sensor for number, sensor in enumerate(scene.sensors())}
    # Area lights belong to their shapes.
    emitters = [emitter for emitter in scene.emitters() if emitter.get_shape() is None]
    parts |= {f"emitter_{number}": emitter for number, emitter in enumerate(emitters)}
    shapes = sorted(scene.shapes(), key=_sort_key)
    parts |= {f"shape_{number:06}": shape for number, shape in enumerate(shapes)}
    names = {part.id(): name for name, part in parts.items()}
    return mi.load_dict({"type": "scene", **parts}, optimize=False), names


def _sort_key(shape: Any) -> tuple[float, ...]:
    """Bounding box (minimum, maximum) and number of primitives of a shape."""
    box = shape.bbox()
    return (*np.ravel(box.min).tolist(), *np.ravel(box.max).tolist(), float(shape.primitive_count()))
