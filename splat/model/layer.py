"""One layer of a forest, Gaussians with parents and labels, and whether layers make complete trees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from splat.model.gaussians import Gaussians, concatenated

NO_PARENT = -1
BACKGROUND = -1
# The trees are binary.
MAX_CHILDREN = 2
LABELS = ("parent", "semantic", "dynamic")


@dataclass(frozen=True)
class Layer:
    """One layer of a forest: N nodes, each a Gaussian.

    Raises:
        ValueError: a tensor has the wrong shape.
    """

    gaussians: Gaussians  # N Gaussians
    # (N,) int32, index in the next coarser layer; -1 in the coarsest, whose nodes are the roots.
    parent: torch.Tensor
    semantic: torch.Tensor  # (N,) int32, instance that a node belongs to; -1 for the background
    dynamic: torch.Tensor  # (N,) bool, whether that instance moves

    def __post_init__(self) -> None:
        n = len(self.gaussians)
        for name, tensor in self.labels():
            if tuple(tensor.shape) != (n,):
                raise ValueError(f"{name} has shape {tuple(tensor.shape)}, expected ({n},)")

    def __len__(self) -> int:
        return len(self.gaussians)

    def labels(self) -> Iterator[tuple[str, torch.Tensor]]:
        """Names and tensors of everything but the Gaussians."""
        for name in LABELS:
            yield name, getattr(self, name)

    def select(self, keep: torch.Tensor) -> Layer:
        """The nodes at an index or a mask (N,)."""
        return Layer(self.gaussians.select(keep), *(tensor[keep] for _, tensor in self.labels()))

    def part(self, start: int, end: int) -> Layer:
        """The nodes from start up to end; shares this layer's memory."""
        return Layer(self.gaussians.part(start, end), *(tensor[start:end] for _, tensor in self.labels()))

    def under(self, parent: NDArray[np.integer]) -> Layer:
        """The same nodes under other parents (N,), indices in the layer above."""
        return replace(self, parent=torch.from_numpy(parent.astype(np.int32)))


def static_layer(gaussians: Gaussians) -> Layer:
    """Gaussians without parents, all of them static background."""
    n = len(gaussians)
    parent, semantic = (torch.full((n,), none, dtype=torch.int32) for none in (NO_PARENT, BACKGROUND))
    return Layer(gaussians, parent, semantic, torch.zeros(n, dtype=torch.bool))


def without_parents(layer: Layer) -> Layer:
    """The nodes with their labels, as the only layer that there is."""
    return replace(layer, parent=torch.full_like(layer.parent, NO_PARENT))


def concatenated_layers(parts: list[Layer]) -> Layer:
    """All nodes of several parts of one layer, in order."""
    labels = (torch.cat([getattr(p, name) for p in parts]) for name in LABELS)
    return Layer(concatenated([p.gaussians for p in parts]), *labels)


def check_forest(layers: list[Layer]) -> None:
    """Checks that in layers, coarsest first, each node has a parent and one or two children with its labels.

    Raises:
        ValueError: says which node is wrong, and how. Layers are counted from 1, the coarsest.
    """
    if not layers:
        raise ValueError("the forest has zero layers")
    for number, layer in enumerate(layers, start=1):
        if not len(layer):
            raise ValueError(f"layer {number} holds no nodes")
        if number == 1:
            if bool((layer.parent != NO_PARENT).any()):
                raise ValueError("broken tree: a node of layer 1 has a parent")
            continue
        above = layers[number - 2]
        wrong = (layer.parent < 0) | (layer.parent >= len(above))
        if bool(wrong.any()):
            raise ValueError(f"broken tree: node {_first(wrong)} of layer {number} has no parent")
        parent = layer.parent.long()
        children = torch.bincount(parent, minlength=len(above))
        for trouble, what in ((children == 0, "no child"), (children > MAX_CHILDREN, "more than 2 children")):
            if bool(trouble.any()):
                raise ValueError(f"broken tree: node {_first(trouble)} of layer {number - 1} has {what}")
        other = (layer.semantic != above.semantic[parent]) | (layer.dynamic != above.dynamic[parent])
        if bool(other.any()):
            raise ValueError(f"labels disagree: node {_first(other)} of layer {number} and its parent")


def _first(mask: torch.Tensor) -> int:
    return int(torch.nonzero(mask)[0])
