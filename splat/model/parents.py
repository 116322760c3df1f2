"""Finds or makes parents for the nodes of a layer (Fov-GS, Algorithm 1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from splat.model.gaussians import written
from splat.model.layer import MAX_CHILDREN, NO_PARENT, Layer, concatenated_layers
from splat.model.merging import merge
from splat.model.neighbours import Neighbours
from splat.model.rows import Floats, Ints, means_of
from splat.model.z_curve import z_curve_order

# Neighbours that are looked up at once; where more are needed, the search goes through all.
NEIGHBOURS = 16


def with_parents(below: Layer, above: Layer, parent: Ints, tries: int) -> tuple[Layer, Ints]:
    """Gives a parent to every node that has none, if necessary a new one.

    Args:
        below: N nodes.
        above: the next coarser layer.
        parent: (N,) index of each node's parent in the layer above; -1 for none.
        tries: how many parents a node tries; the paper's algorithm tries one.

    Returns:
        The layer above with the new parents after the given nodes, and the parent (N,) of every node below.
    """
    parent = parent.copy()
    codes_below, codes_above = label_codes(below, above)
    room = np.full(len(above), MAX_CHILDREN) - np.bincount(parent[parent >= 0], minlength=len(above))
    made: list[Layer] = []
    count = len(above)
    # Nodes of different labels never share a tree.
    for code in np.unique(codes_below[parent < 0]):
        children = np.flatnonzero((parent < 0) & (codes_below == code))
        candidates = np.flatnonzero(codes_above == code)
        centres = means_of(below.gaussians)[children]
        order = z_curve_order(centres)
        children, centres = children[order], centres[order]
        search = _ParentSearch(centres, means_of(above.gaussians)[candidates], room[candidates], tries)
        found = search.run()
        old = found < len(candidates)
        parent[children[old]] = candidates[found[old]]
        parent[children[~old]] = count + found[~old] - len(candidates)
        made.append(_made_parents(below, children[~old], parent[children[~old]] - count))
        count += len(made[-1])
    return concatenated_layers([above, *made]), parent


def label_codes(below: Layer, above: Layer) -> tuple[Ints, Ints]:
    """One number per node of each layer, equal for nodes with the same labels."""
    codes = [2 * layer.semantic.numpy().astype(np.int64) + layer.dynamic.numpy() for layer in (below, above)]
    return codes[0], codes[1]


class _ParentSearch:
    """The loop of Algorithm 1 (lines 3 to 12), child by child.

    Each child tries the nearest parents in turn, including those made for earlier children. If none of
    `tries` parents has room, a new one is made at the child's own position.

    Args:
        children: (N, 3) centres, in the order in which they choose.
        parents: (M, 3) centres.
        room: (M,) children that each parent can still take.
        tries: how many parents a child tries.
    """

    def __init__(self, children: Floats, parents: Floats, room: Ints, tries: int):
        self._children, self._tries = children, tries
        self._given = len(parents)
        self._near_parents = Neighbours(parents, children, tries)
        self._near_children = Neighbours(children, children, NEIGHBOURS + 1)
        self._room = room.tolist()
        # The new parent at each child's position, and the positions of all new ones.
        self._made_for = [-1] * len(children)
        self._made = np.empty_like(children)
        self._count = 0

    def run(self) -> Ints:
        """(N,) index of each child's parent; M + k for the k-th new one."""
        result = np.empty(len(self._children), dtype=np.int64)
        for child in range(len(self._children)):
            chosen = next((parent for parent in self._nearest(child) if self._room[parent] > 0), None)
            if chosen is None:
                chosen = self._make(child)
            self._room[chosen] -= 1
            result[child] = chosen
        return result

    def _nearest(self, child: int) -> list[int]:
        """The nearest parents that there are so far, at most `tries`, nearest first."""
        given, near, tries = self._near_parents, self._near_children, self._tries
        # Lists of plain numbers are quicker to go through, but those of all children take much memory.
        candidates = list(zip(given.distance[child].tolist(), given.index[child].tolist(), strict=True))
        new = 0
        for distance, j in zip(near.distance[child].tolist(), near.index[child].tolist(), strict=True):
            if self._made_for[j] >= 0:
                candidates.append((distance, self._given + self._made_for[j]))
                new += 1
                if new == tries:
                    break
        candidates.sort()
        known = near.reach[child]
        if self._count and new < tries and (len(candidates) < tries or candidates[tries - 1][0] > known):
            # A new parent beyond the known neighbours may be among the nearest: measure all of them.
            candidates = [c for c in candidates if c[1] < self._given]
            distances = np.linalg.norm(self._made[: self._count] - self._children[child], axis=1)
            nearest = np.argpartition(distances, min(tries, self._count) - 1)[:tries]
            candidates += [(float(distances[k]), self._given + int(k)) for k in nearest]
            candidates.sort()
        return [parent for _, parent in candidates[:tries]]

    def _make(self, child: int) -> int:
        """A new parent at a child's position."""
        self._made_for[child] = self._count
        self._made[self._count] = self._children[child]
        self._count += 1
        self._room.append(MAX_CHILDREN)
        return self._given + self._count - 1


def _made_parents(below: Layer, children: Ints, number: Ints) -> Layer:
    """New parents: twice the size of an only child, or the moments of two.

    Args:
        below: the layer of the children.
        children: (C,) indices of the children.
        number: (C,) the new parent of each of them, counted from 0 without gaps.
    """
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
        gaussians = written(gaussians, torch.from_numpy(pairs), merge(left, right))
    return replace(single, gaussians=gaussians, parent=torch.full_like(single.parent, NO_PARENT))
