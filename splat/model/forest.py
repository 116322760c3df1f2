"""The forest: binary trees of Gaussians, all with the same number of layers (Fov-GS, section 3.1 and 3.2).

Layer L holds what the training frames show at full resolution; layer l what they show reduced by
2^(L - l). The trees are built from the bottom up (Algorithm 1). Mended against the paper, whose figure
and text leave it open: a Gaussian that is large enough for a coarse layer is drawn in the finer ones too,
so it goes on below as a child of its own; without that, finer layers would have a hole in its place.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray

from splat.model.gaussians import Gaussians, concatenated
from splat.model.rows import means_of
from splat.model.z_curve import z_curve_order

NO_PARENT = -1
BACKGROUND = -1
MAX_CHILDREN = 2
_LABELS = ("parent", "semantic", "dynamic")


@dataclass(frozen=True)
class Layer:
    """One layer of the forest: N nodes, each a Gaussian.

    Attributes:
        gaussians: N of them.
        parent: (N,) int32, index in the next coarser layer; -1 in the coarsest, whose nodes are the roots.
        semantic: (N,) int32, instance that a node belongs to; -1 for the background.
        dynamic: (N,) bool, whether that instance moves.

    Raises:
        ValueError: a tensor has the wrong shape.
    """

    gaussians: Gaussians
    parent: torch.Tensor
    semantic: torch.Tensor
    dynamic: torch.Tensor

    def __post_init__(self) -> None:
        n = len(self.gaussians)
        for name in _LABELS:
            if tuple(getattr(self, name).shape) != (n,):
                raise ValueError(f"{name} has shape {tuple(getattr(self, name).shape)}, expected ({n},)")

    def __len__(self) -> int:
        return len(self.gaussians)

    def select(self, keep: torch.Tensor) -> Layer:
        """The nodes that an index or a mask (N,) names."""
        return Layer(self.gaussians.select(keep), self.parent[keep], self.semantic[keep], self.dynamic[keep])


@dataclass(frozen=True)
class Forest:
    """A trained forest and what it is of. All nodes lie in one block of memory, coarsest layer first.

    Attributes:
        nodes: of all layers; parents are indices within their layer.
        counts: nodes per layer.
        trained_focal: vertical focal length, in pixels, of the frames that layer L was trained on.
        scene_name, scene_hash: the scene that those frames show.
        attached: further tensors that were fitted to this forest, by name; kept with it, not looked at.
    """

    nodes: Layer
    counts: tuple[int, ...]
    trained_focal: float
    scene_name: str
    scene_hash: str
    attached: dict[str, torch.Tensor] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.counts:
            raise ValueError("the forest has zero layers")
        if sum(self.counts) != len(self.nodes):
            raise ValueError(f"layers of {self.counts} nodes do not make up {len(self.nodes)}")

    @property
    def layers(self) -> list[Layer]:
        """The layers, coarsest first; they share the forest's memory."""
        ends = np.cumsum(self.counts).tolist()
        return [_part(self.nodes, end - count, end) for end, count in zip(ends, self.counts, strict=True)]

    @property
    def finest(self) -> Gaussians:
        """The Gaussians of layer L."""
        return self.layers[-1].gaussians

    def focal_of(self, layer: int) -> float:
        """Vertical focal length in pixels of the frames that layer 1..L was trained on."""
        return self.trained_focal / 2 ** (len(self.counts) - layer)

    def digest(self) -> str:
        """The same for forests with the same Gaussians and attached tensors, and only for those."""
        state = hashlib.sha256(repr((self.counts, self.trained_focal)).encode())
        for tensor in [tensor for _, tensor in self.nodes.gaussians.tensors()] + list(self.attached.values()):
            state.update(np.ascontiguousarray(tensor.detach().numpy()).tobytes())
        return state.hexdigest()[:16]


def forest_of(layers: list[Layer], trained_focal: float, scene_name: str, scene_hash: str) -> Forest:
    """A forest from its layers, coarsest first.

    The nodes of each layer are put in order along a curve through space: those that are drawn together then
    lie together in memory.
    """
    arranged: list[Layer] = []
    place: NDArray[np.int64] | None = None
    for layer in layers:
        order = z_curve_order(means_of(layer))
        moved = layer.select(torch.from_numpy(order))
        if place is not None:
            parent = torch.from_numpy(place[moved.parent.numpy()].astype(np.int32))
            moved = replace(moved, parent=parent)
        place = np.empty(len(layer), dtype=np.int64)
        place[order] = np.arange(len(layer))
        arranged.append(moved)
    counts = tuple(len(layer) for layer in layers)
    return Forest(joined(arranged), counts, trained_focal, scene_name, scene_hash)


def _part(layer: Layer, start: int, end: int) -> Layer:
    gaussians = Gaussians(**{name: t[..., start:end] for name, t in layer.gaussians.tensors()})
    return Layer(gaussians, *(getattr(layer, name)[start:end] for name in _LABELS))


def static_layer(gaussians: Gaussians) -> Layer:
    """Gaussians without parents, all of them static background."""
    n = len(gaussians)
    return Layer(
        gaussians,
        torch.full((n,), NO_PARENT, dtype=torch.int32),
        torch.full((n,), BACKGROUND, dtype=torch.int32),
        torch.zeros(n, dtype=torch.bool),
    )


def joined(parts: list[Layer]) -> Layer:
    """All nodes of several parts of one layer, in order."""
    return Layer(
        concatenated([p.gaussians for p in parts]),
        *(torch.cat([getattr(p, name) for p in parts]) for name in _LABELS),
    )
