"""Completes trees over layers whose nodes have moved, come and gone (Fov-GS, section 3.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from splat.model.building import NEIGHBOURS, Neighbours, label_codes, with_parents
from splat.model.forest import MAX_CHILDREN, NO_PARENT, Layer, joined
from splat.model.rows import Ints, means_of, quaternions_xyzw, rows_of


def settle(layers: list[Layer]) -> list[Layer]:
    """Complete trees over layers whose nodes have moved, come and gone (Fov-GS, section 3.3).

    A child inside its parent's ellipsoid with the same labels stays. The others look for the nearest
    parent that has room. A node left without children takes over a near one whose parent has two.
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
    # A child that had to be copied stands in a layer that is settled already: give it children as well.
    return _grown_down(settled)


def _grown_down(layers: list[Layer]) -> list[Layer]:
    for index in range(len(layers) - 1):
        above, below = layers[index], layers[index + 1]
        childless = np.setdiff1d(np.arange(len(above)), below.parent.numpy())
        if len(childless):
            copies = above.select(torch.from_numpy(childless))
            copies = replace(copies, parent=torch.from_numpy(childless.astype(np.int32)))
            layers[index + 1] = joined([below, copies])
    return layers


def _kept_parents(below: Layer, above: Layer) -> Ints:
    """Parents (N,) that may stay: the child lies within one standard deviation and has the same labels."""
    parent = below.parent.numpy().astype(np.int64)
    known = np.flatnonzero((parent >= 0) & (parent < len(above)))
    of = parent[known]
    offset = means_of(below)[known] - means_of(above)[of]
    turn = Rotation.from_quat(quaternions_xyzw(above.gaussians)[of])
    local = turn.inv().apply(offset) if len(known) else offset
    inside = (local / np.exp(rows_of(above.gaussians.log_scales))[of]) ** 2
    codes_below, codes_above = label_codes(below, above)
    stays = (inside.sum(axis=1) <= 1) & (codes_below[known] == codes_above[of])
    kept = np.full(len(below), NO_PARENT, dtype=np.int64)
    kept[known[stays]] = of[stays]
    # No parent keeps more than it has room for: the first two in order of distance stay.
    order = known[stays][np.argsort(inside.sum(axis=1)[stays], kind="stable")]
    place = _occurrence(kept[order])
    kept[order[place >= MAX_CHILDREN]] = NO_PARENT
    return kept


def _occurrence(values: Ints) -> Ints:
    """How often each value has occurred before it in the array."""
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    starts = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]]) if len(values) else np.zeros(0, int)
    lengths = np.diff(np.r_[starts, len(values)])
    result = np.empty(len(values), dtype=np.int64)
    result[order] = np.arange(len(values)) - np.repeat(starts, lengths)
    return result


def _with_children(below: Layer, above: Layer, parent: Ints) -> tuple[Layer, Ints]:
    """Gives a child to every node above that has none: a near one whose parent has two, else a copy."""
    parent = parent.copy()
    count = np.bincount(parent, minlength=len(above))
    codes_below, codes_above = label_codes(below, above)
    childless = np.flatnonzero(count == 0)
    near = Neighbours(means_of(below), means_of(above)[childless], NEIGHBOURS)
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
    return joined([below, copies]), np.concatenate([parent, np.array(without, dtype=np.int64)])
