"""Elements of a Mitsuba scene's XML."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray


def plugin(kind: str, plugin_type: str, *children: ET.Element, **attributes: str) -> ET.Element:
    """A shape, bsdf, texture, emitter or the like; attributes are its `id` and its `name`."""
    element = ET.Element(kind, {"type": plugin_type, **attributes})
    element.extend(children)
    return element


def value(kind: str, name: str, content: str | float | Iterable[float]) -> ET.Element:
    """A number, text, or colour by its name."""
    return ET.Element(
        kind, {"name": name, "value": content if isinstance(content, str) else numbers(content)}
    )


def to_world(matrix: NDArray[np.float64]) -> ET.Element:
    """A transform from a (4, 4) matrix."""
    element = ET.Element("transform", {"name": "to_world"})
    ET.SubElement(element, "matrix", {"value": numbers(matrix.ravel())})
    return element


def numbers(values: float | Iterable[float]) -> str:
    """Numbers as Mitsuba reads them; float32 keeps nine digits."""
    return ", ".join(f"{float(v):.9g}" for v in (values if isinstance(values, Iterable) else (values,)))
