"""Changes of a loaded scene, after which a forest trained on it is out of date."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer

# Shapes that cover about this fraction of the image are moved or painted.
_SHARE = 0.1
# Number of shapes that are painted.
_PAINTED = 3
_DIMMED = 0.4


def dim_lamps(scene: Scene, camera: Camera) -> None:
    """Dims all lights that have a radiance or an irradiance to two fifths.

    Raises:
        UserError: there are none.
    """
    parameters = mi.traverse(scene.mitsuba)
    keys = _named(parameters, "radiance.")
    if not keys:
        raise UserError(f"{scene.name}: has no light that could be dimmed")
    for key in keys:
        parameters[key] = parameters[key] * _DIMMED
    parameters.update()


def swap_colours(scene: Scene, camera: Camera) -> None:
    """Rotates red, green and blue of all reflectances of three visible shapes.

    These are the ones that cover closest to a tenth of the image.
    """
    for index in _visible(scene, camera)[:_PAINTED]:
        parameters = mi.traverse(scene.mitsuba.shapes()[index].bsdf())
        for key in _named(parameters, "reflectance"):
            value = parameters[key]
            if key.endswith(".data") and value.shape[-1] == 3:
                parameters[key] = mi.TensorXf(np.ascontiguousarray(value.numpy()[..., [1, 2, 0]]))
            elif key.endswith(".value") and len(value) == 3:
                parameters[key] = type(value)(value.y, value.z, value.x)
        parameters.update()


def move_object(scene: Scene, camera: Camera) -> None:
    """Moves a visible mesh to the camera's right by half its size.

    It is the mesh that covers closest to a tenth of the image.

    Raises:
        UserError: no mesh is visible; other shapes have no vertices to move.
    """
    shapes = (mi.traverse(scene.mitsuba.shapes()[index]) for index in _visible(scene, camera))
    # Not is_mesh(): Mitsuba's rectangle claims to be one but does not expose its vertices.
    mesh = next((shape for shape in shapes if "vertex_positions" in shape), None)
    if mesh is None:
        raise UserError(f"{scene.name}: a view sees no mesh that could be moved")
    parameters = mi.traverse(scene.mitsuba)
    values = mesh["vertex_positions"].numpy()
    vertices = values.reshape(-1, 3)  # (N, 3)
    aside = camera.camera_to_world[:3, 0] * 0.5 * float(np.ptp(vertices, axis=0).max())
    # A shape without a name can only be found by its vertices; copies in the same position move along.
    for key in _named(parameters, "vertex_positions"):
        if np.array_equal(parameters[key].numpy(), values):
            parameters[key] = mi.Float((vertices + aside).ravel().astype(np.float32))
    parameters.update()


CHANGES: dict[str, Callable[[Scene, Camera], None]] = {
    "object moved": move_object,
    "texture swapped": swap_colours,
    "lamp dimmed": dim_lamps,
}


def _named(parameters: Any, part: str) -> list[str]:
    """Names of the parameters that contain a text."""
    return [key for key, _ in parameters if part in key]


def _visible(scene: Scene, camera: Camera) -> list[int]:
    """Indices of the visible shapes, those first that cover closest to a tenth of the image."""
    shapes = Tracer(scene).hits(camera, frame_positions(camera)).shape
    indices, counts = np.unique(shapes[shapes >= 0], return_counts=True)
    return indices[np.argsort(np.abs(counts / len(shapes) - _SHARE))].tolist()
