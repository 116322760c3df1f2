"""Gaussians in glTF files: points with the extension KHR_gaussian_splatting of Khronos."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compose.base.errors import one_line
from compose.camera.camera import Array
from pathtrace.gltf.animated_nodes import Animation, Nodes
from pathtrace.gltf.document import GAUSSIANS, Document, read_array, undamaged

_TRIANGLES = 4, 5, 6
_KERNEL = "ellipse"
# Of what Gaussians are blended in: whether that is linear.
_COLOUR_SPACES = {"srgb_rec709_display": False, "lin_rec709_display": True}
_MOST_DEGREES = 3


@dataclass(frozen=True)
class StoredGaussians:
    """N Gaussians of a node."""

    to_world: Array  # (4, 4) of the node
    positions: Array  # (N, 3) of their centres, in the coordinates of the node
    rotations: Array  # (N, 4) quaternions (x, y, z, w), not all 0
    scales: Array  # (N, 3) standard deviations along the principal axes, 0 or more
    opacities: Array  # (N,) from 0 to 1
    sh: Array  # (N, K, 3) spherical harmonics of the colour minus 0.5, K = (degree + 1)^2
    is_linear: bool  # whether that colour is linear, rather than on the sRGB curve; it is what is blended


def read_gaussians(document: Document, remarks: list[str]) -> list[StoredGaussians]:
    """The Gaussians that a document shows at rest, of one degree; none of one that shows triangles."""
    with undamaged(document.file):
        nodes = Nodes(document, Animation())
        to_world = nodes.to_world(np.zeros(1))
        shown = [
            (node, f"meshes[{mesh}].primitives[{number}]", part)
            for node in nodes.shown
            if (mesh := document.section("nodes")[node].get("mesh")) is not None
            for number, part in enumerate(document.item("meshes", mesh, f"nodes[{node}]")["primitives"])
        ]
        if any(part["mode"] in _TRIANGLES for _, _, part in shown):
            return []
        found = [
            _stored(document, part, user, to_world[node][0], remarks)
            for node, user, part in shown
            if GAUSSIANS in part.get("extensions", {})
        ]
    if found and document.section("animations"):
        remarks.append("Gaussians stand still; animations are left out")
    count = max((part.sh.shape[1] for part in found), default=0)
    pads = [((0, 0), (0, count - part.sh.shape[1]), (0, 0)) for part in found]
    return [replace(part, sh=np.pad(part.sh, pad)) for part, pad in zip(found, pads, strict=True)]


def _stored(
    document: Document, part: dict[str, Any], user: str, to_world: Array, remarks: list[str]
) -> StoredGaussians:
    described, attributes = part["extensions"][GAUSSIANS], part["attributes"]
    if (kernel := described.get("kernel")) != _KERNEL:
        remarks.append(one_line(f"{user} is of the kernel {kernel}, and is shown as {_KERNEL}"))
    if (space := described.get("colorSpace")) not in _COLOUR_SPACES:
        remarks.append(one_line(f"{user} has the colour space {space}, and is read as sRGB"))

    def of(name: str, columns: int) -> Array:
        if name not in attributes:
            raise document.refused(f"{user} has no attribute {name}")
        return read_array(document, attributes[name], columns, user)

    own = lambda name, columns: of(f"{GAUSSIANS}:{name}", columns)  # noqa: E731
    degree = next((d for d in range(_MOST_DEGREES, 0, -1) if _harmonic(d, 0) in attributes), 0)
    sh = [of(_harmonic(d, n), 3) for d in range(degree + 1) for n in range(2 * d + 1)]
    arrays = of("POSITION", 3), own("ROTATION", 4), own("SCALE", 3), own("OPACITY", 1)[:, 0]
    positions, rotations, scales, opacities = arrays
    if len({len(values) for values in (*arrays, *sh)}) > 1:
        raise document.refused(f"{user} has attributes of several lengths")
    if (scales < 0).any() or (opacities < 0).any() or (opacities > 1).any():
        raise document.refused(f"{user} has a negative scale, or an opacity that is not from 0 to 1")
    if not rotations.any(axis=1).all():
        raise document.refused(f"{user} has a quaternion without length")
    linear = isinstance(space, str) and _COLOUR_SPACES.get(space, False)
    return StoredGaussians(to_world, positions, rotations, scales, opacities, np.stack(sh, axis=1), linear)


def _harmonic(degree: int, number: int) -> str:
    return f"{GAUSSIANS}:SH_DEGREE_{degree}_COEF_{number}"
