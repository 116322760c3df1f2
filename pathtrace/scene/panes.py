"""Panes of glass: found by their shape, and made to pass light straight on.

A pane with parallel faces shifts what is seen through it by a part of its thickness and turns nothing. With
`thindielectric`, which leaves out that shift, shadow rays may pass it; through `dielectric` none does, and
light behind it is found by chance alone.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from compose.camera.camera import Array
from pathtrace.scene.instances import seen_shapes
from pathtrace.scene.triangles import triangles_of

# Thickness of a pane at most, as a share of its smaller side, and of its size for a single sheet.
_THIN, _FLAT = 0.1, 1e-4
# Cosine from which a face is parallel to the pane, and share of the area that such faces have at least.
_PARALLEL, _FACES = 0.9998, 0.8
# Vertices are the same if they round to the same number of this many steps to the shape's size.
_STEPS = 1e6
_COLOURS = ("specular_reflectance", "specular_transmittance")


def with_thin_glass(scene: mi.Scene) -> int:
    """Makes the panes of a Mitsuba scene pass light straight on, in place; returns how many shapes are panes.

    All connected parts of a pane are thin slabs with parallel faces, or flat sheets, of clear `dielectric`
    without a medium inside, or it is of `thindielectric` already. Each face of a slab passes as much light
    along its normal as it did, and within 3 % as much up to 60 degrees from it.
    """
    panes = pane_shapes(scene)
    for shape in panes:
        if not _is_thin(shape):
            shape.set_bsdf(_thin(shape))
    return len(panes)


def pane_shapes(scene: mi.Scene) -> list[Any]:
    """The shapes of a Mitsuba scene that are panes of glass, as `with_thin_glass` understands them."""
    return [shape for shape in seen_shapes(scene) if _is_thin(shape) or _thin(shape) is not None]


def _is_thin(shape: mi.Shape) -> bool:
    return shape.bsdf().class_name() == "ThinDielectric"


def pane_faces(triangles: Array | None) -> int:
    """Faces of each connected part of triangles (M, 3, 3), if all are panes: 2, 1 for sheets, else 0."""
    if triangles is None or not len(triangles):
        return 0
    # Connected parts share vertices.
    corners = triangles.reshape(-1, 3)
    size = np.ptp(corners, axis=0).max() or 1.0
    _, vertex = np.unique(
        np.round((corners - corners.min(axis=0)) / size * _STEPS), axis=0, return_inverse=True
    )
    vertex = vertex.reshape(-1, 3)
    ends = np.concatenate([vertex[:, :2], vertex[:, 1:]])
    count = int(vertex.max()) + 1
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    of_triangle = label[vertex[:, 0]]
    faces = {_part_faces(triangles[of_triangle == one]) for one in np.unique(of_triangle)}
    return faces.pop() if len(faces) == 1 else 0


def _part_faces(triangles: Array) -> int:
    """2 for a slab, 1 for a sheet, 0 for anything else; triangles of a connected part (M, 3, 3)."""
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(across, axis=1)
    if not area.sum() > 0:
        return 0
    normal = across[area.argmax()] / area.max()
    along = across @ normal
    parallel = np.abs(along) >= _PARALLEL * area
    if area[parallel].sum() < _FACES * area.sum():
        return 0
    corners = triangles.reshape(-1, 3)
    flat = corners - np.outer(corners @ normal, normal)
    middle = flat - flat.mean(axis=0)
    _, sides, axes = np.linalg.svd(middle, full_matrices=False)
    smaller = min(np.ptp(middle @ axis) for axis in axes[:2]) if sides[:2].min() > 0 else 0.0
    thickness = np.ptp(corners @ normal)
    if thickness <= _FLAT * smaller:
        return 1
    height = (triangles[parallel] @ normal).mean(axis=1) - (corners @ normal).min()
    outer = np.minimum(height, thickness - height) <= 0.01 * thickness
    is_front = height > thickness / 2
    front, back = (area[parallel][side].sum() for side in (is_front, ~is_front))
    whole = 0.99 * front <= back <= 1.01 * front
    return 2 if thickness <= _THIN * smaller and outer.all() and whole else 0


def _thin(shape: mi.Shape) -> mi.BSDF | None:
    """A `thindielectric` that stands for one of the faces of a pane of clear glass; None of other shapes."""
    if shape.bsdf().class_name() != "SmoothDielectric" or shape.is_medium_transition():
        return None
    faces, parameters = pane_faces(triangles_of(shape)), mi.traverse(shape.bsdf())
    given = {name for name in _COLOURS if any(key.startswith(name) for key in parameters.keys())}  # noqa: SIM118
    # Textures have no value.
    if not faces or any(f"{name}.value" not in parameters for name in given):
        return None
    values = {name: np.ravel(np.array(parameters[f"{name}.value"])).tolist() for name in given}
    colours = {name: {"type": "rgb", "value": (value * 3)[:3]} for name, value in values.items()}
    index = float(np.ravel(parameters["eta"])[0])
    index = max(index, 1 / index)
    if faces == 2:
        # A `thindielectric` stands for both faces of its pane: it reflects r = 2 R / (1 + R), where one face
        # reflects R. For a slab, which has two of them, r must be the reflectance of one face.
        face = ((index - 1) / (index + 1)) ** 2
        root = float(np.sqrt(face / (2 - face)))
        index = (1 + root) / (1 - root)
    return mi.load_dict({"type": "thindielectric", "int_ior": index, "ext_ior": 1.0, **colours})
