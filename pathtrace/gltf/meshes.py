"""Triangles of a node's mesh, where their vertices are at times, and their PLY files.

Specification, 3.7.2 (meshes, morph targets) and 3.7.3 (skins).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.base.files import write_whole
from compose.camera.camera import Array
from pathtrace.gltf.animated_nodes import Nodes
from pathtrace.gltf.document import Document, NotFiniteError, read_array

Faces = NDArray[np.int64]
# Reads an attribute of an owner with a number of columns, a row for each vertex.
_Reader: TypeAlias = Callable[[dict[str, Any], str, int], Array]

_TRIANGLES, _STRIP, _FAN = 4, 5, 6


@dataclass(frozen=True)
class Skin:
    """How vertices follow joints (3.7.3), J nodes by their numbers."""

    joints: list[int]
    to_joints: Array  # (J, 4, 4) inverse bind matrices, from the mesh at rest to each joint
    which: NDArray[np.int64]  # (V, K) indices of the joints that each vertex follows
    shares: Array  # (V, K) of these, whose sum is 1

    def vertices(self, positions: Array, to_world: list[Array], time: int) -> Array:
        """(V, 3) in the world, of vertices (V, 3) at rest, at one of the times of `to_world`."""
        joints = np.stack([to_world[joint][_row(to_world[joint], time)] for joint in self.joints])
        matrices = np.einsum("vk,vkij->vij", self.shares, (joints @ self.to_joints)[self.which])
        return np.einsum("vij,vj->vi", matrices[:, :3, :3], positions) + matrices[:, :3, 3]


@dataclass(frozen=True)
class Primitive:
    """A part of the mesh of a node, of one material."""

    name: str  # of the node or its mesh, for people
    node: int  # its number
    material: int | None  # number of the material; None of one without
    faces: Faces  # (F, 3) indices of vertices
    positions: Array  # (V, 3) of vertices, before they are morphed, in the coordinates of the mesh
    normals: Array | None  # (V, 3), or None: faces are flat
    uvs: dict[int, Array]  # (V, 2) by the number of their set
    colours: Array | None  # (V, 3) linear factors on the base colour, or None
    targets: Array  # (M, V, 3) displacements of the morph targets
    default_weights: Array  # (M,) of them, as the mesh has them
    skin: Skin | None  # None of a mesh that follows its node alone

    def vertices(self, nodes: Nodes, times: Array) -> Iterator[Array]:
        """(V, 3) in the world at each of the times (T,) in seconds."""
        to_world = nodes.to_world(times)
        weights = nodes.weights(self.node, self.default_weights, times)
        for time in range(len(times)):
            own = weights[_row(weights, time)][: len(self.targets)]
            morphed = self.positions + np.einsum("m,mvi->vi", own, self.targets[: len(own)])
            if self.skin is None:
                matrix = to_world[self.node][_row(to_world[self.node], time)]
                yield morphed @ matrix[:3, :3].T + matrix[:3, 3]
            else:
                # Where the node itself is does not count.
                yield self.skin.vertices(morphed, to_world, time)


def _row(values: Array, time: int) -> int:
    return min(time, len(values) - 1)


def read_primitives(document: Document, nodes: Nodes, remarks: list[str]) -> list[Primitive]:
    """All triangles that are shown, and remarks about what is not; UserError if a mesh is damaged."""
    found = []
    for node in nodes.shown:
        item = document.section("nodes")[node]
        if "mesh" not in item:
            continue
        mesh = document.item("meshes", item["mesh"], f"nodes[{node}]")
        name = str(item.get("name") or mesh.get("name") or f"node{node}")
        for number, part in enumerate(mesh["primitives"]):
            user = f"meshes[{item['mesh']}].primitives[{number}]"
            if part["mode"] not in (_TRIANGLES, _STRIP, _FAN):
                remarks.append(f"{user} has points or lines, and is left out")
                continue
            try:
                primitive = _primitive(document, node, name, mesh, part, user)
            except NotFiniteError:
                remarks.append(f"{user} holds numbers that are not finite, and is left out")
                continue
            if _has_area(primitive.faces, primitive.positions, *primitive.targets):
                found.append(primitive)
            else:
                remarks.append(f"{user} has no triangle with an area, and is left out")
    return found


def _primitive(
    document: Document, node: int, name: str, mesh: dict[str, Any], part: dict[str, Any], user: str
) -> Primitive:
    attributes = part["attributes"]
    if "POSITION" not in attributes:
        raise document.refused(f"{user} has no POSITION")
    positions = read_array(document, attributes["POSITION"], 3, user)

    def of_vertices(owner: dict[str, Any], key: str, columns: int | tuple[int, ...]) -> Array:
        values = read_array(document, owner[key], columns, f"{user}.{key}")
        if len(values) != len(positions):
            raise document.refused(f"{user} has {len(values)} {key} for {len(positions)} vertices")
        return values

    targets = [
        of_vertices(target, "POSITION", 3) if "POSITION" in target else np.zeros_like(positions)
        for target in part.get("targets", [])
    ]
    sets = [key for key in attributes if key.startswith("TEXCOORD_") and key[9:].isdecimal()]
    colours = of_vertices(attributes, "COLOR_0", (3, 4))[:, :3] if "COLOR_0" in attributes else None
    faces = _faces(document, part, len(positions), user)
    stacked = np.stack(targets) if targets else np.zeros((0, *positions.shape))
    return Primitive(
        name,
        node,
        int(part["material"]) if "material" in part else None,
        faces,
        positions,
        of_vertices(attributes, "NORMAL", 3) if "NORMAL" in attributes else None,
        {int(key[9:]): of_vertices(attributes, key, 2) for key in sets},
        colours,
        stacked,
        np.array(mesh.get("weights", [0.0] * len(targets)), dtype=np.float64),
        _skin(document, node, attributes, of_vertices),
    )


def _faces(document: Document, part: dict[str, Any], vertices: int, user: str) -> Faces:
    """(F, 3) indices of vertices, of triangles, strips and fans."""
    if "indices" in part:
        corners = read_array(document, part["indices"], 1, user)[:, 0].astype(np.int64)
    else:
        corners = np.arange(vertices)
    if len(corners) and (corners.min() < 0 or corners.max() >= vertices):
        raise document.refused(f"{user} has an index of {corners.max()}; it has {vertices} vertices")
    if part["mode"] == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    first = np.arange(max(len(corners) - 2, 0))
    if part["mode"] == _FAN:
        return corners[np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)]
    odd = first % 2
    return corners[np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)]


def _has_area(faces: Faces, positions: Array, *targets: Array) -> bool:
    """Whether a triangle has an area, at rest or fully morphed to one of the targets."""
    for moved in (positions, *(positions + target for target in targets)):
        a, b, c = (moved[faces[:, corner]] for corner in range(3))
        if np.cross(b - a, c - a).any():
            return True
    return False


def _skin(
    document: Document,
    node: int,
    attributes: dict[str, Any],
    of_vertices: _Reader,
) -> Skin | None:
    item = document.section("nodes")[node]
    if "skin" not in item or "JOINTS_0" not in attributes:
        return None
    skin, user = document.item("skins", item["skin"], f"nodes[{node}]"), f"skins[{item['skin']}]"
    joints = [int(joint) for joint in skin["joints"]]
    for joint in joints:
        document.item("nodes", joint, user)
    to_joints = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in skin:
        matrices = read_array(document, skin["inverseBindMatrices"], 16, user)
        if len(matrices) < len(joints):
            raise document.refused(f"{user} has {len(matrices)} matrices for {len(joints)} joints")
        # Column by column.
        to_joints = matrices[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
    sets = [number for number in range(len(attributes)) if f"JOINTS_{number}" in attributes]
    if any(f"WEIGHTS_{number}" not in attributes for number in sets):
        raise document.refused(f"nodes[{node}] has JOINTS without WEIGHTS")
    which = np.hstack([of_vertices(attributes, f"JOINTS_{number}", 4) for number in sets]).astype(np.int64)
    if which.min() < 0 or which.max() >= len(joints):
        raise document.refused(f"nodes[{node}] has a joint of {which.max()}; {user} has {len(joints)}")
    shares = np.hstack([of_vertices(attributes, f"WEIGHTS_{number}", 4) for number in sets])
    # Vertices that follow nothing follow the first joint that they name.
    shares[shares.sum(axis=1) <= 0, 0] = 1.0
    return Skin(joints, to_joints, which, shares / shares.sum(axis=1, keepdims=True))


def write_mesh(
    file: Path,
    faces: Faces,
    positions: Array,
    normals: Array | None = None,
    uvs: Array | None = None,
    colours: Array | None = None,
) -> None:
    """Writes a mesh to a .ply file; the order of its vertices is kept.

    Faces (F, 3) are indices of vertices, at positions (V, 3); normals (V, 3) are unit vectors; uvs (V, 2)
    have v from the top of the image, as Mitsuba has it; colours (V, 3) are linear, Mitsuba's `vertex_color`.
    """
    has_normals, has_uvs = normals is not None, uvs is not None
    mesh = mi.Mesh(
        file.stem, len(positions), len(faces), has_vertex_normals=has_normals, has_vertex_texcoords=has_uvs
    )
    parameters = mi.traverse(mesh)
    parameters["faces"] = faces.astype(np.uint32).ravel()
    given = {"vertex_positions": positions, "vertex_normals": normals, "vertex_texcoords": uvs}
    for name, content in given.items():
        if content is not None:
            parameters[name] = content.astype(np.float32).ravel()
    parameters.update()
    if colours is not None:
        values = colours.astype(np.float32).ravel()
        mesh.add_attribute("vertex_color", 3, values)  # type: ignore[arg-type]  # arrays as well
    write_whole(file, lambda part: mesh.write_ply(str(part)))
