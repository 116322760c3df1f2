"""Whether the fovea is fooled: worlds that changed after the splats were trained."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera
from hybrid.bench.fusion import Candidates, crops, means, measured, unfitted_views
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.runtime.device import device_arrays
from pathtrace.dataset.frames import FrameSet
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest

# What a shape should take of a crop to be worth moving or painting.
_SHARE = 0.1
_DIMMED = 0.4


def dim_lamps(scene: Scene, camera: Camera) -> None:
    """All lights that have a radiance or an irradiance at two fifths."""
    parameters = mi.traverse(scene.mitsuba)
    keys = _named(parameters, "radiance.")
    if not keys:
        raise UserError(f"{scene.name}: has no light that could be dimmed")
    for key in keys:
        parameters[key] = parameters[key] * _DIMMED
    parameters.update()


def swap_colours(scene: Scene, camera: Camera) -> None:
    """Red, green and blue change places in every reflectance of three shapes.

    They are those in sight whose shares of it are nearest to a tenth.
    """
    for index in _seen(scene, camera)[:3]:
        parameters = mi.traverse(scene.mitsuba.shapes()[index].bsdf())
        for key in _named(parameters, "reflectance"):
            value = parameters[key]
            if key.endswith(".data") and value.shape[-1] == 3:
                parameters[key] = mi.TensorXf(np.ascontiguousarray(value.numpy()[..., [1, 2, 0]]))
            elif key.endswith(".value") and len(value) == 3:
                parameters[key] = type(value)(value.y, value.z, value.x)
        parameters.update()


def move_object(scene: Scene, camera: Camera) -> None:
    """The mesh whose share of what the camera sees is nearest to a tenth goes aside by half its size.

    Raises:
        UserError: no mesh is in sight; other shapes have no vertices to move.
    """
    shapes = (mi.traverse(scene.mitsuba.shapes()[index]) for index in _seen(scene, camera))
    # Not is_mesh: Mitsuba's rectangle says that it is one, and keeps its vertices to itself.
    mesh = next((shape for shape in shapes if "vertex_positions" in shape), None)
    if mesh is None:
        raise UserError(f"{scene.name}: a view sees no mesh that could be moved")
    parameters = mi.traverse(scene.mitsuba)
    values = mesh["vertex_positions"].numpy()
    vertices = values.reshape(-1, 3)
    aside = camera.camera_to_world[:3, 0] * 0.5 * float(np.ptp(vertices, axis=0).max())
    # Shapes may be without a name: the one with these vertices is it, and a copy that lies in it goes along.
    for key in _named(parameters, "vertex_positions"):
        if np.array_equal(parameters[key].numpy(), values):
            parameters[key] = mi.Float((vertices + aside).ravel().astype(np.float32))
    parameters.update()


CHANGES: dict[str, Callable[[Scene, Camera], None]] = {
    "object moved": move_object,
    "texture swapped": swap_colours,
    "lamp dimmed": dim_lamps,
}


def bench_change(
    load: Callable[[], Scene],
    frames: FrameSet,
    forest: Forest,
    spp: int,
    reference_spp: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per change and method: means over the unfitted views' crops, the forest as it was.

    Args:
        load: gives the scene anew, to be changed.
        frames, forest: of the scene as it was.
        spp: samples per pixel in the fovea.
        reference_spp: of the changed scene's references.
        progress: called with pictures done and pictures in all.
    """
    places = list(crops(unfitted_views(frames), (1,), 0.4))
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    for number, (change, apply) in enumerate(CHANGES.items()):
        for place, crop in enumerate(places):
            scene = load()
            apply(scene, crop.camera)
            candidates = Candidates(device_arrays(), scene, forest)
            truth = reference(candidates.tracer, crop.camera, reference_spp, REFERENCE_SEED).radiance
            for method, image in candidates.images(crop.camera, spp, 0).items():
                found.setdefault((change, method), []).append(measured(image, truth))
            progress(number * len(places) + place + 1, len(CHANGES) * len(places))
    return [
        {
            "change": change,
            "method": method,
            "spp": spp,
            **means(rows),
        }
        for (change, method), rows in found.items()
    ]


def _named(parameters: Any, part: str) -> list[str]:
    return [key for key, _ in parameters if part in key]


def _seen(scene: Scene, camera: Camera) -> list[int]:
    """Indices of the shapes in sight, those first that fill about a tenth of it."""
    shapes = Tracer(scene).hits(camera, frame_positions(camera)).shape
    indices, counts = np.unique(shapes[shapes >= 0], return_counts=True)
    return indices[np.argsort(np.abs(counts / len(shapes) - _SHARE))].tolist()
