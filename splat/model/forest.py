"""The forest: binary trees of Gaussians, all with the same number of layers (Fov-GS, section 3.1 and 3.2).

Layer L holds what the training frames show at full resolution, layer l what they show reduced by 2^(L - l).
The trees are built from the bottom up (Algorithm 1). The paper leaves one point open: here, a Gaussian large
enough for a coarse layer continues below as its own child, or the finer layers would have a hole.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np
import torch
from numpy.typing import NDArray

from compose.camera.coordinate_systems import WORLD, Place
from splat.model.dynamic_light import LightCourse, SurfaceLight
from splat.model.gaussians import Blending, Gaussians
from splat.model.hierarchy import Hierarchy, HierarchyNodes, hierarchy_of
from splat.model.motion import Dynamics
from splat.model.points import rows_of, z_curve_order
from splat.model.trees import Layer, concatenated_layers

# What is attached under names with this prefix says how a forest was made; its hash does not depend on that.
ABOUT = "about."


@dataclass(frozen=True)
class Forest:
    """A trained forest and the scene it shows. All nodes lie in one block of memory, coarsest layer first.

    Attributes:
        nodes: of all layers; parents are indices within their layer.
        counts: nodes per layer.
        trained_focal: vertical focal length, in pixels, of the frames that layer L was trained on.
        scene_name, scene_hash: the scene that those frames show.
        attached: further tensors that were fitted to this forest, by name; stored with it, not interpreted.
        place: the coordinates of the nodes; those of the world by default.
        motion: of the instances that dynamic nodes belong to, in the same coordinates; None if nothing moves.
            The nodes are those at rest.
        light: how the radiance of some nodes changes over time; None if it does not.
        hierarchy: over the Gaussians of layer L, for continuous levels of detail; None if none is stored.

    Raises:
        ValueError: there are no layers, their counts do not sum to the number of nodes, a node belongs to an
            instance without a motion, or light is of nodes that there are not.
    """

    nodes: Layer
    counts: tuple[int, ...]
    trained_focal: float
    scene_name: str
    scene_hash: str
    attached: dict[str, torch.Tensor] = field(default_factory=dict)
    place: Place = WORLD
    motion: Dynamics | None = None
    light: LightCourse | None = None
    hierarchy: Hierarchy | None = None

    def __post_init__(self) -> None:
        if not self.counts:
            raise ValueError("the forest has zero layers")
        if sum(self.counts) != len(self.nodes):
            raise ValueError(f"layers of {self.counts} nodes do not make up {len(self.nodes)}")
        if self.motion is not None and len(self.nodes):
            last = int(self.nodes.semantic.max())
            if last >= len(self.motion):
                raise ValueError(f"nodes of instance {last}; there are motions of {len(self.motion)}")
        if self.light is not None and len(self.light.nodes):
            first, last = int(self.light.nodes.min()), int(self.light.nodes.max())
            if first < 0 or last >= len(self.nodes):
                raise ValueError(f"light of nodes {first} to {last}; there are {len(self.nodes)}")

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """First index of each layer's nodes, and the one after the last."""
        return list(pairwise(accumulate(self.counts, initial=0)))

    @property
    def layers(self) -> list[Layer]:
        """The layers, coarsest first; they share the forest's memory."""
        return [self.nodes.part(first, end) for first, end in self.ranges]

    @property
    def finest(self) -> Gaussians:
        """The Gaussians of layer L."""
        return self.layers[-1].gaussians

    @cached_property
    def hierarchy_nodes(self) -> HierarchyNodes:
        """The nodes of the hierarchy; the first are those of layer L."""
        return self.own_hierarchy.nodes(self.finest)

    @cached_property
    def own_hierarchy(self) -> Hierarchy:
        """The hierarchy, which is built now if none is stored."""
        return self.hierarchy or hierarchy_of(self.layers[-1])

    def coarsest_alone(self, sh: torch.Tensor | None = None) -> Forest:
        """The coarsest layer as a forest, in usual light; with constant harmonics (1, 3, N), if given."""
        layer, alone = self.layers[0], replace(self, attached={}, light=None, hierarchy=None)
        if sh is not None:
            shown = replace(layer.gaussians, sh=sh, directional=None, blending=Blending.LINEAR)
            layer = replace(layer, gaussians=shown)
        return replace(alone, nodes=layer, counts=(len(layer),), trained_focal=self.focal_of(1))

    def focal_of(self, layer: int) -> float:
        """Vertical focal length in pixels of the frames that a layer, 1 to L, was trained on."""
        return self.trained_focal / 2 ** (len(self.counts) - layer)

    def digest(self) -> str:
        """Hash of the Gaussians, their place and blending, and the attached tensors but those of ABOUT."""
        # Forests in world coordinates, and those that are blended linearly, keep their earlier hash.
        place = (self.place,) if self.place != WORLD else ()
        blending = self.nodes.gaussians.blending
        blended = () if blending is Blending.LINEAR else (blending.value,)
        state = hashlib.sha256(repr((self.counts, self.trained_focal, *place, *blended)).encode())
        motion = () if self.motion is None else (self.nodes.semantic, *self.motion.tensors().values())
        light = () if self.light is None else tuple(self.light.tensors().values())
        own = self.nodes.gaussians.every_tensor()
        # Files do not keep their order.
        attached = [self.attached[name] for name in sorted(self.attached) if not name.startswith(ABOUT)]
        for tensor in [*own, *attached, *motion, *light]:
            state.update(np.ascontiguousarray(tensor.detach().numpy()).tobytes())
        return state.hexdigest()[:16]


def forest_of(
    layers: list[Layer],
    trained_focal: float,
    scene_name: str,
    scene_hash: str,
    place: Place = WORLD,
    motion: Dynamics | None = None,
    light: SurfaceLight | None = None,
) -> Forest:
    """Builds a forest from its layers, coarsest first; `place` says in which coordinates they and light are.

    The nodes of each layer are sorted along a space-filling curve: nodes that are drawn together then lie
    together in memory.
    """
    arranged: list[Layer] = []
    position: NDArray[np.int64] | None = None
    for layer in layers:
        order = z_curve_order(rows_of(layer.gaussians.means))
        moved = layer.select(torch.from_numpy(order))
        if position is not None:
            moved = moved.under(position[moved.parent.numpy()])
        position = np.empty(len(layer), dtype=np.int64)
        position[order] = np.arange(len(layer))
        arranged.append(moved)
    counts, nodes = tuple(map(len, layers)), concatenated_layers(arranged)
    course = None if light is None else light.course(nodes)
    return Forest(nodes, counts, trained_focal, scene_name, scene_hash, {}, place, motion, course)
