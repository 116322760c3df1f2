"""Writes triangles as PLY files."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.base.files import write_whole

Array = NDArray[np.float64]


def write_mesh(
    file: Path,
    faces: NDArray[np.int64],
    positions: Array,
    normals: Array | None = None,
    uvs: Array | None = None,
    colours: Array | None = None,
) -> None:
    """Writes a mesh; the order of its vertices is kept.

    Args:
        file: a .ply file.
        faces: (F, 3) indices of vertices.
        positions: (V, 3).
        normals: (V, 3), unit; none are written if left out.
        uvs: (V, 2), v from the top of the image, as Mitsuba has it; likewise.
        colours: (V, 3), linear, which Mitsuba calls `vertex_color`; likewise.
    """
    mesh = mi.Mesh(
        file.stem,
        len(positions),
        len(faces),
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=uvs is not None,
    )
    parameters = mi.traverse(mesh)
    parameters["faces"] = faces.astype(np.uint32).ravel()
    values = {"vertex_positions": positions, "vertex_normals": normals, "vertex_texcoords": uvs}
    for name, content in values.items():
        if content is not None:
            parameters[name] = content.astype(np.float32).ravel()
    parameters.update()
    if colours is not None:
        mesh.add_attribute("vertex_color", 3, colours.astype(np.float32).ravel())
    write_whole(file, lambda part: mesh.write_ply(str(part)))
