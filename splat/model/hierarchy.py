"""A binary tree over one set of Gaussians, deep enough for a level of detail of its own in every direction.

Inner nodes have the moments of their two children, as in hierarchical 3D Gaussians (Kerbl et al. 2024), whose
cuts the perceptually guided levels of detail move; or they were fitted (`splat.training.picture_fit`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splat.model.gaussians import SH_DC, Gaussians, concatenated
from splat.model.points import Bits, Floats, Ints, remoteness, rows_of
from splat.model.trees import Layer, label_codes, merge

# Rounds of pairing per octave of size, and passes per round; neighbours among which a partner is sought.
_PER_OCTAVE, _PASSES, _NEIGHBOURS = 2, 2, 8
# The first round joins what is up to this quantile of the sizes; the last one, a part of the whole.
_FIRST, _MOST_ROUNDS = 0.25, 48
# Partners are at most so many sizes of a round apart.
_FARTHEST = 2.0
# A step of the whole perceptual scale in colour counts as so many sizes of a round.
_COLOUR = 0.6
# Points are moved apart by up to this share of a round's size, each by another multiple of the golden ratio.
_APART, _GOLDEN = 1e-3, 0.6180339887498949
# Contrast of nodes whose sizes are their extents.
USUAL_CONTRAST = 0.02
# A parent is larger than its children by at least this factor, so that cuts are well defined.
_LARGER = 1.1


@dataclass(frozen=True)
class Hierarchy:
    """Which nodes are joined: N leaves come first, then M inner nodes, children before their parents.

    ValueError if there are inner nodes or contrasts, but not M.

    Attributes:
        children: (M, 2) int32, indices among all N + M nodes, the larger child first.
        inner: M inner nodes that were fitted; None if they have the moments of their children.
        contrast: (M,) positive, how much it shows that an inner node is drawn in place of the leaves below
            it: where its extent is so many pixels, the root of the sum of squared errors of sRGB values, over
            these. None if that was not measured.
    """

    children: torch.Tensor
    inner: Gaussians | None = None
    contrast: torch.Tensor | None = None

    def __post_init__(self) -> None:
        if self.inner is not None and len(self.inner) != len(self.children):
            raise ValueError(f"a hierarchy of {len(self.children)} pairs and {len(self.inner)} inner nodes")
        if self.contrast is not None and self.contrast.shape != (len(self.children),):
            shape = tuple(self.contrast.shape)
            raise ValueError(f"a hierarchy of {len(self.children)} pairs and contrasts of shape {shape}")

    def __len__(self) -> int:
        return len(self.children)

    def parents(self, leaves: int) -> Ints:
        """(N + M,) the parent of each node, over N leaves; -1 for roots.

        ValueError if the pairs do not make trees over so many leaves.
        """
        children = self.children.numpy().astype(np.int64)
        number = leaves + np.arange(len(children))
        flat = children.ravel()
        if len(flat) and (flat.min() < 0 or (children >= number[:, None]).any()):
            raise ValueError("a hierarchy in which a node lies above nodes that there are not")
        if len(np.unique(flat)) != len(flat):
            raise ValueError("a hierarchy in which a node has two parents")
        parent = np.full(leaves + len(children), -1)
        parent[flat] = np.repeat(number, 2)
        return parent

    def nodes(self, leaves: Gaussians) -> HierarchyNodes:
        """All nodes, of the leaves that the hierarchy was built over."""
        children, count = self.children.numpy().astype(np.int64), len(leaves)
        parent = self.parents(count)
        contrast = self._contrasts(parent)
        extent = np.concatenate([leaves.longest.numpy().astype(np.float64), np.zeros(len(children))])
        size, radius, nodes = extent * contrast, np.zeros(len(extent)), leaves
        highest, end = children.max(axis=1) if len(children) else children[:, 0], 0
        while end < len(children):
            # As many as have all children before them.
            start, later = end, np.flatnonzero(highest[end:] >= count + end)
            end = start + int(later[0]) if len(later) else len(children)
            pairs = children[start:end]
            if self.inner is None:
                merged = merge(*(nodes.select(torch.from_numpy(side)) for side in pairs.T))
            else:
                merged = self.inner.part(start, end)
            new = slice(count + start, count + end)
            extent[new] = merged.longest.numpy()
            size[new] = np.maximum(contrast[new] * extent[new], _LARGER * size[pairs].max(axis=1))
            away = rows_of(merged.means) - rows_of(nodes.means[:, torch.from_numpy(pairs)])  # (2, P, 3)
            reach = np.linalg.norm(away, axis=2).T + radius[pairs]
            radius[new] = reach.max(axis=1)
            nodes = concatenated([nodes, merged])
        is_heir = np.ones(len(size), dtype=bool)
        is_heir[children[:, 1]] = False
        bounds = np.float32(size), np.float32(extent), np.float32(radius)
        return HierarchyNodes(nodes, parent.astype(np.int32), is_heir, *bounds, count)

    def _contrasts(self, parent: Ints) -> Floats:
        """(N + M,) of all nodes, in parts of the usual one; leaves have that of the node above them."""
        if self.contrast is None:
            return np.ones(len(parent))
        leaves, inner = len(parent) - len(self), self.contrast.numpy().astype(np.float64) / USUAL_CONTRAST
        above = parent[:leaves] - leaves
        of_leaves = np.where(above < 0, 1.0, np.append(inner, 1.0)[above])
        return np.concatenate([of_leaves, inner])


@dataclass(frozen=True)
class HierarchyNodes:
    """The nodes of a hierarchy: N leaves, then M inner nodes."""

    gaussians: Gaussians  # N + M
    parent: NDArray[np.int32]  # (N + M,) -1 for roots
    is_heir: Bits  # (N + M,) whether it is the larger child, or a root
    size: NDArray[np.float32]  # (N + M,) extent, by contrast, which levels limit; parents' are larger
    extent: NDArray[np.float32]  # (N + M,) standard deviation along the longest axis
    radius: NDArray[np.float32]  # (N + M,) within which of its centre all centres below a node lie
    leaves: int  # N

    def siblings(self) -> Ints:
        """(N + M,) the other child of each node's parent; of a root itself."""
        found = np.arange(len(self.parent))
        below = np.flatnonzero(self.parent >= 0)
        # Both children of a parent follow each other.
        pairs = below[np.argsort(self.parent[below], kind="stable")].reshape(-1, 2)
        found[pairs] = pairs[:, ::-1]
        return found

    def levels(self, count: int, ratio: int) -> list[Gaussians]:
        """Up to `count` levels of detail, the leaves first, each with a `ratio`-th of the nodes before.

        Nodes of a level are about equally large, as seen from where viewers are.
        """
        size = self.size / remoteness(self.gaussians.means).numpy()
        above = np.where(self.parent < 0, np.inf, size[np.maximum(self.parent, 0)])
        own = np.where(np.arange(len(size)) < self.leaves, 0, size)
        found: list[Ints] = [np.arange(self.leaves)]
        # At a limit, nodes are drawn that are no larger while their parents are.
        starts, ends = np.sort(own), np.sort(above)
        drawn = np.searchsorted(starts, starts, "right") - np.searchsorted(ends, starts, "right")
        while len(found) < count:
            enough = np.flatnonzero(drawn <= len(found[-1]) // ratio)
            if not len(enough):
                break
            limit = starts[enough[0]]
            found.append(np.flatnonzero((own <= limit) & (above > limit)))
        return [self.gaussians.select(torch.from_numpy(level)) for level in found]


def hierarchy_of(leaves: Layer, progress: Callable[[int, int], None] | None = None) -> Hierarchy:
    """Pairs Gaussians from the smallest to the largest, near ones of similar colour first.

    Only Gaussians with the same labels are joined. Those that find no partner are roots.

    Args:
        leaves: N Gaussians.
        progress: is told how many of N have been joined.
    """
    gaussians = leaves.gaussians
    building = _Building(gaussians, label_codes(leaves))
    limit = float(np.quantile(building.relative, _FIRST)) if len(gaussians) else 0.0
    for _ in range(_MOST_ROUNDS):
        before = building.joined
        for _ in range(_PASSES):
            building.join(limit)
            if progress is not None:
                progress(building.joined, len(gaussians))
        if len(building.active) < 2 or (limit > building.extent and building.joined == before):
            break
        limit *= 2 ** (1 / _PER_OCTAVE)
    pairs = building.pairs
    children = np.concatenate(pairs) if pairs else np.zeros((0, 2), np.int64)
    return Hierarchy(torch.from_numpy(children.astype(np.int32)))


class _Building:
    """Nodes without a parent so far, by their numbers among all, and what has been joined."""

    def __init__(self, leaves: Gaussians, codes: Ints):
        self.active = np.arange(len(leaves))
        self.pairs: list[Ints] = []
        self._count, self._gaussians, self._codes = len(leaves), leaves, codes
        self._size = leaves.longest.numpy().astype(np.float64)
        means = rows_of(leaves.means)
        near = means[remoteness(leaves.means).numpy() == 1]
        self.extent = float(np.ptp(near, axis=0).max()) if len(near) else 1.0

    @property
    def joined(self) -> int:
        return sum(map(len, self.pairs))

    @property
    def relative(self) -> Floats:
        """Sizes of the active nodes as seen from where viewers are: what is far away may be larger."""
        return self._size / remoteness(self._gaussians.means).numpy()

    def join(self, limit: float) -> None:
        few = np.flatnonzero(self.relative <= limit)
        if len(few) < 2:
            return
        pairs = few[self._partners(few, limit)]
        if not len(pairs):
            return
        smaller = self._size[pairs[:, 0]] < self._size[pairs[:, 1]]
        pairs[smaller] = pairs[smaller, ::-1]
        left, right = (self._gaussians.select(torch.from_numpy(side)) for side in pairs.T)
        merged = merge(left, right)
        self.pairs.append(self.active[pairs])
        rest = np.ones(len(self.active), dtype=bool)
        rest[pairs] = False
        number = self._count + np.arange(len(pairs))
        self._count += len(pairs)
        self.active = np.concatenate([self.active[rest], number])
        self._size = np.concatenate([self._size[rest], _size(merged, self._size[pairs])])
        self._codes = np.concatenate([self._codes[rest], self._codes[pairs[:, 0]]])
        kept = self._gaussians.select(torch.from_numpy(np.flatnonzero(rest)))
        self._gaussians = concatenated([kept, merged])

    def _partners(self, few: Ints, limit: float) -> Ints:
        """(P, 2) positions within `few` of pairs, which share no node."""
        means = self._gaussians.means[:, few]
        colour = (0.5 + SH_DC * self._gaussians.sh[0][:, few]).clamp(0, 1).numpy().T
        points, codes = rows_of(means), self._codes[few]
        # Points in one place would all have the same few neighbours.
        points[:, 0] += _APART * limit * (np.arange(len(few)) * _GOLDEN % 1)
        distance, near = cKDTree(points).query(points, k=min(_NEIGHBOURS + 1, len(few)), workers=-1)
        distance, near = distance[:, 1:], near[:, 1:]
        distance /= limit * remoteness(means).numpy()[:, None]
        cost = distance + _COLOUR * np.abs(colour[near] - colour[:, None]).sum(axis=2)
        cost[(distance > _FARTHEST) | (codes[near] != codes[:, None])] = np.inf
        # Those that are each other's cheapest free neighbour, until there are none.
        own, pairs = np.arange(len(near)), [np.zeros((0, 2), np.int64)]
        while True:
            choice = cost.argmin(axis=1)
            best = near[own, choice]
            possible = np.isfinite(cost[own, choice])
            found = np.flatnonzero(possible & possible[best] & (best[best] == own) & (own < best))
            if not len(found):
                return np.concatenate(pairs)
            pairs.append(np.stack([found, best[found]], axis=1))
            taken = np.zeros(len(near), dtype=bool)
            taken[pairs[-1]] = True
            cost[taken] = np.inf
            cost[taken[near]] = np.inf


def _size(merged: Gaussians, children: Floats) -> Floats:
    """(M,) sizes of merged Gaussians, from those of their children (M, 2)."""
    return np.maximum(merged.longest.numpy(), _LARGER * children.max(axis=1))


class CutTree:
    """How N leaves and M inner nodes lie above each other, for complete cuts.

    A cut is kept as the inner nodes that are split, which are not drawn themselves: their children stand for
    them. A node is drawn if all that is above it is split and it is not. So any choice of split nodes,
    however old or wrong it is, makes a set of nodes of which every leaf has exactly one above it, or is it.

    Args:
        parent: (N + M,) of each node, leaves first; -1 for roots.
        leaves: N.

    Attributes:
        leaves, inner: N and M.
        roots: how many nodes have no parent.
        above: (N + M,) of each node the inner node above it, M for roots.
        by_depth: inner nodes, from the roots down.
    """

    def __init__(self, parent: NDArray[np.int32], leaves: int):
        self.leaves, self.inner = leaves, len(parent) - leaves
        self.roots = int(np.count_nonzero(parent < 0))
        # Roots lie below one more, which is always split.
        self.above = np.where(parent < 0, self.inner, parent.astype(np.int64) - leaves)
        above = self.above[leaves:]
        depth = np.zeros(self.inner, dtype=np.int64)
        # Children come before their parents.
        deeper = np.flatnonzero(above < self.inner)
        while len(deeper):
            found = depth[above[deeper]] + 1
            deeper = deeper[found != depth[deeper]]
            depth[deeper] = depth[above[deeper]] + 1
        order = np.argsort(depth, kind="stable")
        self.by_depth: list[Ints] = np.split(order, np.flatnonzero(np.diff(depth[order])) + 1)

    def falling(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Of M values of inner nodes the least at each node and those above it."""
        found = np.append(values, np.float32(np.inf))
        for nodes in self.by_depth:
            found[nodes] = np.minimum(found[nodes], found[self.above[self.leaves + nodes]])
        return found[:-1]

    def closed(self, split: Bits) -> Bits:
        """(M,) those of the inner nodes that are split above which all are split as well."""
        return self.falling(split.astype(np.float32)) > 0

    def drawn(self, split: Bits) -> Bits:
        """(N + M,) the nodes of the cut in which inner nodes (M,) are split, whichever they are."""
        closed = self.closed(split)
        found = np.append(closed, True)[self.above]
        found[self.leaves :] &= ~closed
        return found
