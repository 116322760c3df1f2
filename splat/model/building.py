"""Builds the trees of a forest from the bottom up (Fov-GS, Algorithm 1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splat.model.forest import MAX_CHILDREN, NO_PARENT, Layer, joined
from splat.model.gaussians import Gaussians
from splat.model.merging import merge
from splat.model.rows import Floats, Ints, means_of
from splat.model.z_curve import z_curve_order

# Neighbours that are looked up at once; where none of them will do, the search goes through all.
NEIGHBOURS = 16


def children_of(above: Layer, below: Layer) -> NDArray[np.int32]:
    """(N, 2) indices of each node's children in the next finer layer, the smaller one left; -1 for none."""
    parent = below.parent.numpy()
    order = np.lexsort((longest_axis(below.gaussians), parent))
    sorted_parent = parent[order]
    second = np.zeros(len(order), dtype=np.int64)
    second[1:] = sorted_parent[1:] == sorted_parent[:-1]
    children = np.full((len(above), MAX_CHILDREN), -1, dtype=np.int32)
    children[sorted_parent, second] = order
    return children


def longest_axis(gaussians: Gaussians) -> NDArray[np.float32]:
    """(N,) largest standard deviation: the 3D size of the paper."""
    return gaussians.log_scales.detach().max(dim=0).values.exp().numpy()


def layer_of_size(size: NDArray[np.floating], pixel: float, layers: int) -> Ints:
    """(N,) layer, 1 to L, that a Gaussian's size puts it in.

    Layer L below 4 pixels, layer l from 2^(L - l + 1) to 2^(L - l + 2) pixels, layer 1 above: what a frame
    reduced by 2^(L - l) can still sample. (The printed upper bound 2^L s_L f d must read 2^L s_L d / f.)

    Args:
        size: longest axes in world space.
        pixel: d / f, the size of a pixel of the training frames at their mean depth d.
        layers: L.
    """
    octave = np.floor(np.log2(np.maximum(size / pixel, 2.0))).astype(np.int64)
    return np.clip(layers + 1 - octave, 1, layers)


def build_forest(finest: Layer, pixel: float, layers: int) -> list[Layer]:
    """Algorithm 1: trees over the Gaussians of one trained set, which becomes layer L as it is.

    Args:
        finest: the Gaussians and their labels.
        pixel: size of a pixel of the training frames at their mean depth.
        layers: L.

    Returns:
        The layers, coarsest first. The same set gives the same forest, whatever its order in memory.
    """
    level = layer_of_size(longest_axis(finest.gaussians), pixel, layers)
    below = replace(finest, parent=torch.full((len(finest),), NO_PARENT, dtype=torch.int32))
    # Where each node of the layer below came from, if it is one of the given Gaussians.
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


def with_parents(below: Layer, above: Layer, parent: Ints, tries: int) -> tuple[Layer, Ints]:
    """Gives a parent to every node that has none; those that had to be made are added to the layer above.

    Returns:
        The layer above, and the parent (N,) of every node below.
    """
    parent = parent.copy()
    codes_below, codes_above = label_codes(below, above)
    room = np.full(len(above), MAX_CHILDREN) - np.bincount(parent[parent >= 0], minlength=len(above))
    made: list[Layer] = []
    count = len(above)
    # Nodes of different labels never meet: each label is a forest of its own.
    for code in np.unique(codes_below[parent < 0]):
        children = np.flatnonzero((parent < 0) & (codes_below == code))
        candidates = np.flatnonzero(codes_above == code)
        centres = means_of(below)[children]
        order = z_curve_order(centres)
        children, centres = children[order], centres[order]
        found = _search_parents(centres, means_of(above)[candidates], room[candidates], tries)
        old = found < len(candidates)
        parent[children[old]] = candidates[found[old]]
        parent[children[~old]] = count + found[~old] - len(candidates)
        made.append(_made_parents(below, children[~old], parent[children[~old]] - count))
        count += len(made[-1])
    return joined([above, *made]), parent


def _search_parents(children: Floats, parents: Floats, room: Ints, tries: int) -> Ints:
    """The loop of Algorithm 1 (lines 3 to 12), child after child.

    Each child tries the nearest parents in turn, those made on the way among them; where none of `tries`
    has room it makes one, at its own place.

    Args:
        children: (N, 3) centres in the order in which they choose.
        parents: (M, 3) centres.
        room: (M,) children that each of them can still take.
        tries: how many parents a child tries; the paper's algorithm tries one.

    Returns:
        (N,) index of each child's parent; M + k for the k-th one made.
    """
    if not len(children):
        return np.zeros(0, dtype=np.int64)
    given = Neighbours(parents, children, tries)
    near = Neighbours(children, children, NEIGHBOURS + 1)
    left = room.tolist()
    maker = [-1] * len(children)  # which new parent stands at a child's place
    made, count = np.empty_like(children), 0
    result = np.empty(len(children), dtype=np.int64)
    for child in range(len(children)):
        # Nearest first: those given, and those made at the places of earlier children.
        candidates = list(zip(given.distance[child], given.index[child], strict=True))
        new = 0
        for distance, j in zip(near.distance[child], near.index[child], strict=True):
            if maker[j] >= 0:
                candidates.append((distance, len(parents) + maker[j]))
                new += 1
                if new == tries:
                    break
        candidates.sort()
        known = near.reach[child]
        if count and new < tries and (len(candidates) < tries or candidates[tries - 1][0] > known):
            # What was made further away than the neighbours known may still be among the nearest.
            candidates = [c for c in candidates if c[1] < len(parents)]
            distances = np.linalg.norm(made[:count] - children[child], axis=1)
            nearest = np.argpartition(distances, min(tries, count) - 1)[:tries]
            candidates += [(float(distances[k]), len(parents) + int(k)) for k in nearest]
            candidates.sort()
        chosen = next((p for _, p in candidates[:tries] if left[p] > 0), None)
        if chosen is None:
            chosen = len(parents) + count
            maker[child] = count
            made[count] = children[child]
            count += 1
            left.append(MAX_CHILDREN)
        left[chosen] -= 1
        result[child] = chosen
    return result


class Neighbours:
    """The nearest `count` of M points to each of N places, looked up all at once.

    Attributes:
        distance, index: per place, nearest first.
        reach: per place, the distance up to which no point is missing.
    """

    def __init__(self, points: Floats, places: Floats, count: int):
        count = min(count, len(points))
        self.distance: list[list[float]] = [[]] * len(places)
        self.index: list[list[int]] = [[]] * len(places)
        self.reach = [np.inf] * len(places)
        if count:
            distance, index = cKDTree(points).query(places, k=np.arange(1, count + 1), workers=-1)
            self.distance, self.index = distance.tolist(), index.tolist()
            if count < len(points):
                self.reach = distance[:, -1].tolist()


def _made_parents(below: Layer, children: Ints, number: Ints) -> Layer:
    """New parents, twice the size of an only child, the moments of two."""
    order = np.argsort(number, kind="stable")
    children, number = children[order], number[order]
    first = np.flatnonzero(np.r_[True, number[1:] != number[:-1]]) if len(number) else np.zeros(0, int)
    single = below.select(torch.from_numpy(children[first]))
    doubled = single.gaussians.log_scales + float(np.log(2.0))
    gaussians = replace(single.gaussians, log_scales=doubled)
    pairs = np.flatnonzero(np.diff(np.r_[first, len(number)]) == MAX_CHILDREN)
    if len(pairs):
        left = below.gaussians.select(torch.from_numpy(children[first[pairs]]))
        right = below.gaussians.select(torch.from_numpy(children[first[pairs] + 1]))
        merged = merge(left, right)
        for name, tensor in gaussians.tensors():
            tensor[..., torch.from_numpy(pairs)] = getattr(merged, name)
    return replace(single, gaussians=gaussians, parent=torch.full_like(single.parent, NO_PARENT))


def label_codes(below: Layer, above: Layer) -> tuple[Ints, Ints]:
    """One number per node, the same for nodes with the same labels."""
    codes = [2 * layer.semantic.numpy().astype(np.int64) + layer.dynamic.numpy() for layer in (below, above)]
    return codes[0], codes[1]
