"""Complete cuts of a hierarchy: sets of nodes of which every leaf has exactly one above it, or is it.

A cut is kept as the inner nodes that are split, which are not drawn themselves: their children stand for
them. A node is drawn if all that is above it is split and it is not. So any choice of split nodes, whatever
it was made for, and however old or wrong it is, makes a complete cut.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splat.model.points import Ints

Bits = NDArray[np.bool_]


class CutTree:
    """How N leaves and M inner nodes lie above each other.

    Args:
        parent: (N + M,) of each node, leaves first; -1 for roots.
        leaves: N.

    Attributes:
        leaves, inner: N and M.
        roots: how many nodes have no parent.
    """

    def __init__(self, parent: NDArray[np.int32], leaves: int):
        self.leaves, self.inner = leaves, len(parent) - leaves
        self.roots = int(np.count_nonzero(parent < 0))
        # Of each node the inner node above it; roots lie below one more, which is always split.
        self._above = np.where(parent < 0, self.inner, parent.astype(np.int64) - leaves)
        above = self._above[leaves:]
        depth = np.zeros(self.inner, dtype=np.int64)
        # Children come before their parents.
        deeper = np.flatnonzero(above < self.inner)
        while len(deeper):
            found = depth[above[deeper]] + 1
            deeper = deeper[found != depth[deeper]]
            depth[deeper] = depth[above[deeper]] + 1
        order = np.argsort(depth, kind="stable")
        self._by_depth: list[Ints] = np.split(order, np.flatnonzero(np.diff(depth[order])) + 1)

    def falling(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Of M values of inner nodes the least at each node and those above it."""
        found = np.append(values, np.float32(np.inf))
        for nodes in self._by_depth:
            found[nodes] = np.minimum(found[nodes], found[self._above[self.leaves + nodes]])
        return found[:-1]

    def closed(self, split: Bits) -> Bits:
        """(M,) those of the inner nodes that are split above which all are split as well."""
        found = np.append(split, True)
        for nodes in self._by_depth:
            found[nodes] &= found[self._above[self.leaves + nodes]]
        return found[:-1]

    def drawn(self, split: Bits) -> Bits:
        """(N + M,) the nodes of the cut in which inner nodes (M,) are split, whichever they are."""
        closed = self.closed(split)
        found = np.append(closed, True)[self._above]
        found[self.leaves :] &= ~closed
        return found
