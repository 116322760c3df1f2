"""Completes the trees over layers whose nodes were moved, added and removed (Fov-GS, section 3.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from splat.model.layer import MAX_CHILDREN, NO_PARENT, Layer, concatenated_layers
from splat.model.neighbours import Neighbours
from splat.model.parents import NEIGHBOURS, label_codes, with_parents
from splat.model.rows import Ints, means_of, quaternions_xyzw, rows_of


def settle(layers: list[Layer]) -> list[Layer]:
    """Completes the trees over trained layers.

    A child inside its parent's ellipsoid and with the same labels keeps its parent. The others choose the
    nearest parent that has room. A node left without children takes one from a nearby node that has two.

    Args:
        layers: coarsest first; parents may be missing, out of range, or too many children may share one.

    Returns:
        The layers, coarsest first: the given nodes in their order, and new nodes after them.
    """
    settled = [layers[-1]]
    for above in reversed(layers[:-1]):
        below = settled[0]
        parent = _kept_parents(below, above)
        above, parent = with_parents(below, above, parent, tries=NEIGHBOURS)
        below, parent = _with_children(below, above, parent)
        settled[0] = replace(below, parent=torch.from_numpy(parent.astype(np.int32)))
        settled.insert(0, above)
    settled[0] = replace(settled[0], parent=torch.full((len(settled[0]),), NO_PARENT, dtype=torch.int32))
    # Copies were added as children to layers that were complete already; they need children as well.
    return _grown_down(settled)


def _grown_down(layers: list[Layer]) -> list[Layer]:
    """Gives every node without children a copy of itself as a child, from the top down."""
    for index in range(len(layers) - 1):
        above, below = layers[index], layers[index + 1]
        childless = np.setdiff1d(np.arange(len(above)), below.parent.numpy())
        if len(childless):
            copies = above.select(torch.from_numpy(childless))
            copies = replace(copies, parent=torch.from_numpy(childless.astype(np.int32)))
            layers[index + 1] = concatenated_layers([below, copies])
    return layers


def _kept_parents(below: Layer, above: Layer) -> Ints:
    """(N,) parents that children may keep, else -1: within one standard deviation, with the same labels."""
    parent = below.parent.numpy().astype(np.int64)
    known = np.flatnonzero((parent >= 0) & (parent < len(above)))
    of = parent[known]
    offset = means_of(below.gaussians)[known] - means_of(above.gaussians)[of]
    turn = Rotation.from_quat(quaternions_xyzw(above.gaussians)[of])
    local = turn.inv().apply(offset) if len(known) else offset
    inside = (local / np.exp(rows_of(above.gaussians.log_scales))[of]) ** 2
    codes_below, codes_above = label_codes(below, above)
    stays = (inside.sum(axis=1) <= 1) & (codes_below[known] == codes_above[of])
    kept = np.full(len(below), NO_PARENT, dtype=np.int64)
    kept[known[stays]] = of[stays]
    # Where more children would stay than fit, the two nearest do.
    order = known[stays][np.argsort(inside.sum(axis=1)[stays], kind="stable")]
    kept[order[_occurrence(kept[order]) >= MAX_CHILDREN]] = NO_PARENT
    return kept


def _occurrence(values: Ints) -> Ints:
    """(N,) how often each value occurs before its position in the array."""
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    starts = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]]) if len(values) else np.zeros(0, int)
    lengths = np.diff(np.r_[starts, len(values)])
    result = np.empty(len(values), dtype=np.int64)
    result[order] = np.arange(len(values)) - np.repeat(starts, lengths)
    return result


def _with_children(below: Layer, above: Layer, parent: Ints) -> tuple[Layer, Ints]:
    """Gives a child to every node above that has none: a nearby node's second child, else a copy of itself.

    Returns:
        The layer below with the copies after the given nodes, and the parent of every node in it.
    """
    parent = parent.copy()
    count = np.bincount(parent, minlength=len(above))
    codes_below, codes_above = label_codes(below, above)
    childless = np.flatnonzero(count == 0)
    near = Neighbours(means_of(below.gaussians), means_of(above.gaussians)[childless], NEIGHBOURS)
    without = []
    for node, candidates in zip(childless, near.index, strict=True):
        for child in candidates:
            if codes_below[child] == codes_above[node] and count[parent[child]] == MAX_CHILDREN:
                count[parent[child]] -= 1
                count[node] += 1
                parent[child] = node
                break
        else:
            without.append(node)
    copies = above.select(torch.tensor(without, dtype=torch.long))
    return concatenated_layers([below, copies]), np.concatenate([parent, np.array(without, dtype=np.int64)])
