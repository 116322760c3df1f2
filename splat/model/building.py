"""Builds the trees of a forest from the bottom up (Fov-GS, Algorithm 1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from splat.model.gaussians import Gaussians
from splat.model.layer import NO_PARENT, Layer
from splat.model.parents import with_parents
from splat.model.remoteness import remoteness
from splat.model.rows import Ints


def build_forest(finest: Layer, pixel: float, layers: int) -> list[Layer]:
    """Builds trees over the Gaussians of one trained set, which becomes layer L unchanged (Algorithm 1).

    Args:
        finest: the Gaussians and their labels.
        pixel: size in world space of a pixel of the training frames at their mean depth.
        layers: L.

    Returns:
        The layers, coarsest first. They do not depend on the order of the set in memory.
    """
    # The sky is huge, and yet its Gaussians are as small in a frame as others.
    size = longest_axis(finest.gaussians) / remoteness(finest.gaussians.means).numpy()
    level = layer_of_size(size, pixel, layers)
    below = replace(finest, parent=torch.full((len(finest),), NO_PARENT, dtype=torch.int32))
    # For each node of the layer below, the given Gaussian that it is; -1 for a new parent.
    origin = np.arange(len(finest))
    forest: list[Layer] = []
    for number in range(layers, 1, -1):
        # A given Gaussian of a coarser class is a node of the layer above, and its own child.
        itself = (origin >= 0) & (level[np.maximum(origin, 0)] < number)
        above = below.select(torch.from_numpy(np.flatnonzero(itself)))
        parent = np.full(len(below), NO_PARENT, dtype=np.int64)
        parent[itself] = np.arange(int(itself.sum()))
        above, parent = with_parents(below, above, parent, tries=1)
        forest.insert(0, replace(below, parent=torch.from_numpy(parent.astype(np.int32))))
        origin = np.concatenate([origin[itself], np.full(len(above) - int(itself.sum()), -1)])
        below = above
    return [below, *forest]


def longest_axis(gaussians: Gaussians) -> NDArray[np.float32]:
    """(N,) largest standard deviation: the 3D size of the paper."""
    return gaussians.log_scales.detach().max(dim=0).values.exp().numpy()


def layer_of_size(size: NDArray[np.floating], pixel: float, layers: int) -> Ints:
    """(N,) layer, 1 to L, that a Gaussian belongs to by its size.

    Layer L takes sizes below 4 pixels, layer l from 2^(L - l + 1) to 2^(L - l + 2) pixels, layer 1 all above:
    what a frame reduced by 2^(L - l) can still sample. (The printed upper bound 2^L s_L f d must read
    2^L s_L d / f.)

    Args:
        size: (N,) longest axes in world space.
        pixel: d / f, the size of a pixel of the training frames at their mean depth d.
        layers: L.
    """
    octave = np.floor(np.log2(np.maximum(size / pixel, 2.0))).astype(np.int64)
    return np.clip(layers + 1 - octave, 1, layers)
