"""A deterministic order of a scene's shapes."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np


def in_order(scene: Any) -> Any:
    """The same scene with its shapes in an order of their own.

    Where Mitsuba merges meshes, it leaves them in another order each time that a scene is loaded, and with
    them their lights: a random number would choose another one, and the same seed give other noise.
    """
    parts = {f"sensor_{number}": sensor for number, sensor in enumerate(scene.sensors())}
    alone = [emitter for emitter in scene.emitters() if emitter.get_shape() is None]
    parts |= {f"emitter_{number}": emitter for number, emitter in enumerate(alone)}
    shapes = sorted(scene.shapes(), key=_sort_key)
    parts |= {f"shape_{number:06}": shape for number, shape in enumerate(shapes)}
    return mi.load_dict({"type": "scene", **parts}, optimize=False)


def _sort_key(shape: Any) -> tuple[float, ...]:
    """Numbers by which shapes can be told apart."""
    box = shape.bbox()
    return (*np.ravel(box.min).tolist(), *np.ravel(box.max).tolist(), float(shape.primitive_count()))
