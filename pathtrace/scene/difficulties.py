"""What in a scene keeps its light from converging, by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from pathtrace.scene.instances import seen_shapes
from pathtrace.scene.panes import pane_shapes
from pathtrace.scene.scene import Scene

# Area, as a share of the square of the scene's size, below which a light is tiny: scattered rays hardly ever
# hit it. Share of the light of all area lights from which that of tiny ones counts.
_TINY, _MUCH = 1e-3, 0.3
# Roughness (alpha) up to which a glossy surface focuses light.
_NARROW = 0.15
_NAMED = 3


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
    """Causes by which light of a scene converges slowly, found from its description alone, without tracing.

    They are causes, not a measurement: whether a view shows them, and how much, is not known.
    """
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


def _focuses(shape: Any) -> bool:
    """Whether a shape has a mirror, clear glass or nearly such a surface, a layer of it included."""
    flags = int(shape.bsdf().flags())
    if flags & (int(mi.BSDFFlags.DeltaReflection) | int(mi.BSDFFlags.DeltaTransmission)):
        return True
    glossy = int(mi.BSDFFlags.GlossyReflection) | int(mi.BSDFFlags.GlossyTransmission)
    if not flags & glossy:
        return False
    parameters = mi.traverse(shape.bsdf())
    widths = [
        float(np.mean(np.array(parameters[name])))
        for name in parameters.keys()  # noqa: SIM118
        if name.endswith(("alpha", "alpha.value", "alpha_u.value"))
    ]
    return bool(widths) and min(widths) <= _NARROW


def _sends_narrow_light(scene: Any) -> bool:
    """Whether much of the light is that of a sun, or of area lights that are tiny for the scene."""
    box = scene.bbox()
    size = float(np.linalg.norm(np.array(box.max) - np.array(box.min)))
    tiny, total = 0.0, 0.0
    for emitter in scene.emitters():
        if "sky" in str(emitter).lower().partition("[")[0]:
            return True
        if (shape := emitter.get_shape()) is not None:
            area = float(np.ravel(shape.surface_area())[0])
            power = area * _radiance(emitter)
            total += power
            tiny += power if area < _TINY * size**2 else 0.0
    return tiny > _MUCH * total


def _radiance(emitter: Any) -> float:
    """Mean radiance of an area light; 1 if it is a texture."""
    parameters = mi.traverse(emitter)
    return float(np.mean(parameters["radiance.value"])) if "radiance.value" in parameters else 1.0


def _names(shapes: list[Any]) -> tuple[str, ...]:
    """Names of the BSDFs of shapes: meshes of one BSDF are merged, and lose theirs."""
    return tuple(sorted({shape.bsdf().id() or shape.bsdf().class_name() for shape in shapes}))
