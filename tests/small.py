"""Scenes and settings small enough to render and train in a test."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

if TYPE_CHECKING:
    from pathtrace.scene.scene import Scene


def denoising_error() -> float:
    """How far denoisings of the same image may lie apart, relatively: a card's are of half precision."""
    return 0.02 if mi.variant().startswith("cuda") else 1e-4


def resident_memory() -> int:
    """Bytes of the process that are in memory now (Linux)."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def sensor(width: int = 32, height: int = 32, fov: float = 60.0) -> dict[str, Any]:
    """A camera at (0.3, 0.2, -1), looking towards the origin, a little off."""
    return {
        "type": "perspective",
        "fov": fov,
        "fov_axis": "y",
        "to_world": mi.ScalarTransform4f().look_at(
            origin=[0.3, 0.2, -1.0], target=[0.1, 0.0, 0.4], up=[0, 1, 0]
        ),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        },
    }


def furnace(reflectance: float = 0.5) -> dict[str, Any]:
    """A closed sphere of radius 3 whose wall emits 1 - rho and reflects rho: radiance 1 everywhere."""
    return {
        "type": "scene",
        "sensor": sensor(),
        "sphere": {
            "type": "sphere",
            "radius": 3.0,
            "flip_normals": True,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1 - reflectance}},
        },
    }


def _quad(scale: float, offset: list[float], reflectance: list[float]) -> dict[str, Any]:
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate(offset).scale(scale),
        "bsdf": {
            "type": "twosided",
            "b": {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}},
        },
    }


def corner() -> dict[str, Any]:
    """Two walls of different colour, a mirror ball, a lamp: enough for shadow, reflection and colour."""
    return {
        "type": "scene",
        "sensor": sensor(),
        "back": _quad(4, [0, 0, 2.0], [0.7, 0.6, 0.3]),
        "board": _quad(0.5, [-0.6, 0.1, 1.2], [0.2, 0.3, 0.8]),
        "ball": {"type": "sphere", "center": [0.5, -0.1, 1.0], "radius": 0.35, "bsdf": {"type": "conductor"}},
        "lamp": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f()
            .look_at(origin=[0, 2.5, -1], target=[0, 0, 1], up=[0, 0, 1])
            .scale(0.7),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 12.0}},
        },
    }


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def set_all(scene: Scene, name: str, value: float) -> None:
    """Sets all parameters of a loaded scene whose names end in this."""
    parameters = mi.traverse(scene.mitsuba)
    for key in [key for key, _ in parameters if key.endswith(name)]:
        parameters[key] = type(parameters[key])(value)
    parameters.update()
