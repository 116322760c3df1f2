"""Meshes for which Mitsuba refuses a whole scene: without faces, or with numbers that are not finite."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

_FILES = "ply", "obj"
# What Mitsuba 3.9 says of a mesh with NaN or infinity.
_NOT_FINITE = re.compile("invalid vertex (position|normal) data")
_PLY_FACES = re.compile(rb"element\s+face\s+(\d+)")
# Bytes in which the header of a PLY file ends.
_HEADER = 1 << 16


def degenerate_meshes(state: Any) -> dict[int, str]:
    """What is wrong with each degenerate mesh of a parsed scene, by the number of its node.

    The scene's folder is one in which Mitsuba looks for files.
    """
    found = {}
    for number, node in enumerate(state.nodes):
        if (
            node.type == mi.ObjectType.Shape
            and node.props.plugin_name() in _FILES
            and "filename" in node.props
        ):
            name = str(node.props["filename"])
            file = Path(str(mi.file_resolver().resolve(name)))
            wrong = _wrong(node.props, file) if file.is_file() else None
            if wrong is not None:
                found[number] = f"the mesh {name} {wrong}"
    return found


def without(state: Any, numbers: Collection[int]) -> None:
    """Takes nodes out of a parsed scene, and instances of groups in which nothing is left."""
    # With an empty group in memory, Dr.Jit refuses to record kernels of any scene.
    left_out, kinds = set(numbers), mi.Properties.Type
    parts = [of_kind(node.props, kinds.ResolvedReference) for node in state.nodes]
    held = [{part.index() for part in found.values()} for found in parts]
    empty = {n for n, node in enumerate(state.nodes) if _is(node, "shapegroup") and held[n] <= left_out}
    ids = {state.nodes[number].props.id() for number in empty}
    for number, node in enumerate(state.nodes):
        named = {part.id() for part in of_kind(node.props, kinds.Reference).values()}
        if _is(node, "instance") and (named & ids or held[number] & empty):
            left_out.add(number)
    for node, found in zip(state.nodes, parts, strict=True):
        for name, part in found.items():
            if part.index() in left_out | empty:
                del node.props[name]


def _is(node: Any, plugin: str) -> bool:
    return bool(node.props.plugin_name() == plugin)


def of_kind(properties: Any, kind: Any) -> dict[str, Any]:
    """Properties of a type, by name."""
    return {name: properties[name] for name in list(properties.keys()) if properties.type(name) == kind}


def _wrong(properties: Any, file: Path) -> str | None:
    """What is wrong with a mesh; None if that is nothing, or something else."""
    if not _has_faces(file):
        return "has no faces"
    shape = {"type": properties.plugin_name(), "filename": str(file)}
    if "to_world" in properties:
        if not np.isfinite(np.array(properties["to_world"].matrix)).all():
            return "has a to_world that is not finite"
        shape["to_world"] = properties["to_world"]
    try:
        mi.load_dict(shape)
    except RuntimeError as error:
        if _NOT_FINITE.search(str(error)):
            return "has vertices that are not finite"
    return None


def _has_faces(file: Path) -> bool:
    with file.open("rb") as opened:
        if file.suffix.lower() == ".ply":
            count = _PLY_FACES.search(opened.read(_HEADER))
            return count is None or int(count[1]) > 0
        return any(line.lstrip().startswith(b"f") for line in opened)
