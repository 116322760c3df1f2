"""Where the nodes of a glTF file are at times (specification, 3.5)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pathtrace.gltf.animation import Animation
from pathtrace.gltf.document import Document

Array = NDArray[np.float64]


class Nodes:
    """The nodes of a file while an animation plays.

    Attributes:
        shown: numbers of the nodes of the scene that is shown, parents first.
        animation: as given.

    Raises:
        UserError: a node has two parents, is its own ancestor, or does not exist.
    """

    def __init__(self, document: Document, animation: Animation):
        self.animation = animation
        self._items = document.section("nodes")
        self._parents = _parents(document, self._items)
        self._order = _parents_first(document, self._parents)
        self.shown = self._below(set(_roots(document, self._parents)))

    def __len__(self) -> int:
        return len(self._items)

    def to_world(self, times: Array) -> list[Array]:
        """Of each node, (T, 4, 4) at times (T,) in seconds; (1, 4, 4) of those that stand still."""
        found: dict[int, Array] = {}
        for node in self._order:
            own, parent = self._local(node, times), self._parents[node]
            found[node] = own if parent is None else found[parent] @ own
        return [found[node] for node in range(len(self._items))]

    def ancestors(self, node: int) -> list[int]:
        """A node, its parent, and so on."""
        found: list[int] = []
        upper: int | None = node
        while upper is not None:
            found.append(upper)
            upper = self._parents[upper]
        return found

    def weights(self, node: int, default: Array, times: Array) -> Array:
        """(T, M) of a node's M morph targets; (1, M), the default of its mesh, if nothing else says them."""
        sampler = self.animation.channels.get((node, "weights"))
        if sampler is not None:
            return sampler.at(times)
        return np.atleast_2d(np.asarray(self._items[node].get("weights", default), dtype=np.float64))

    def _below(self, roots: set[int]) -> list[int]:
        found = set(roots)
        found.update(node for node in self._order if self._parents[node] in found)
        return [node for node in self._order if node in found]

    def _local(self, node: int, times: Array) -> Array:
        """(T, 4, 4) or (1, 4, 4): translation, rotation and scale, or a matrix."""
        item = self._items[node]
        shift, turn, scale = (self._values(node, item, path, times) for path in _PATHS)
        local = np.tile(np.eye(4), (max(len(shift), len(turn), len(scale)), 1, 1))
        local[:, :3, :3] = Rotation.from_quat(turn).as_matrix() * scale[:, None]
        local[:, :3, 3] = shift
        # Column by column.
        return local @ np.reshape(item["matrix"], (4, 4)).T.astype(np.float64)

    def _values(self, node: int, item: dict[str, Any], path: str, times: Array) -> Array:
        sampler = self.animation.channels.get((node, path))
        found = np.array([item[path]], dtype=np.float64) if sampler is None else sampler.at(times)
        if path == "rotation" and not found.any(axis=1).all():
            return np.array([[0.0, 0.0, 0.0, 1.0]])
        return found


_PATHS = ("translation", "rotation", "scale")


def _parents(document: Document, items: list[dict[str, Any]]) -> list[int | None]:
    found: list[int | None] = [None] * len(items)
    for parent, item in enumerate(items):
        for child in item.get("children", []):
            document.item("nodes", child, f"nodes[{parent}]")
            if found[int(child)] is not None:
                raise document.refused(f"nodes[{child}] has two parents")
            found[int(child)] = parent
    return found


def _parents_first(document: Document, parents: list[int | None]) -> list[int]:
    children: dict[int | None, list[int]] = {}
    for node, parent in enumerate(parents):
        children.setdefault(parent, []).append(node)
    order = list(children.get(None, []))
    for node in order:
        order += children.get(node, [])
    if len(order) < len(parents):
        lost = min(set(range(len(parents))) - set(order))
        raise document.refused(f"nodes[{lost}] is its own ancestor")
    return order


def _roots(document: Document, parents: list[int | None]) -> list[int]:
    """Roots of the scene that a viewer is to show, the first one if the file does not say."""
    if not document.section("scenes"):
        return [node for node, parent in enumerate(parents) if parent is None]
    scene = document.item("scenes", document.tree.get("scene", 0), "scene")
    for node in scene.get("nodes", []):
        document.item("nodes", node, "scene")
    return [int(node) for node in scene.get("nodes", [])]
