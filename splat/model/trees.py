"""A forest's layers and trees: built bottom up (Fov-GS, Algorithm 1), completed after training (3.3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import expit, log_expit

from splat.model.gaussians import (
    SH_DC,
    Blending,
    Gaussians,
    concatenated,
    perceptual_from_radiance,
    radiance_from_perceptual,
    written,
)
from splat.model.points import Floats, Ints, Neighbours, quaternions_xyzw, remoteness, rows_of, z_curve_order

NO_PARENT = -1
BACKGROUND = -1
# The trees are binary.
MAX_CHILDREN = 2
LABELS = ("parent", "semantic", "dynamic")


@dataclass(frozen=True)
class Layer:
    """One layer of a forest: N nodes, each a Gaussian; ValueError if a tensor has the wrong shape."""

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

    A ValueError says which node is wrong, and how. Layers are counted from 1, the coarsest.
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


_MAXIMUM_OPACITY = 0.99
# Least ratio of the shortest axis of a merged Gaussian to its longest.
_FLATTEST = 1e-7


def merge(a: Gaussians, b: Gaussians) -> Gaussians:
    """Merges N pairs of Gaussians of one degree, which are blended alike.

    The weights are w = o S, with o the opacity and S = s1 s2 + s1 s3 + s2 s3, half the surface of a box with
    the standard deviations as sides. Mean, covariance and colour, as it is blended, are means weighted by w;
    the opacity is (w_a + w_b) / S of the result, at most 0.99.
    """
    # Logarithms: weights of tiny or transparent Gaussians would be 0, and their shares 0 / 0.
    weight_a, weight_b = (
        log_expit(rows_of(g.opacity_logits)) + _log_surface(rows_of(g.log_scales)) for g in (a, b)
    )
    share = expit(weight_a - weight_b)
    mean_a, mean_b = rows_of(a.means), rows_of(b.means)
    mean = share[:, None] * mean_a + (1 - share)[:, None] * mean_b
    covariance = sum(
        part[:, None, None] * (_covariance(g) + np.einsum("ni,nj->nij", centre - mean, centre - mean))
        for part, g, centre in ((share, a, mean_a), (1 - share, b, mean_b))
    )
    variance, axes = np.linalg.eigh(covariance)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    # Eigenvalues are exact to a share of the largest one only, and rounding can make the others negative.
    log_scales = 0.5 * np.log(np.maximum(variance, _FLATTEST**2 * variance[:, -1:]))
    log_opacity = np.logaddexp(weight_a, weight_b) - _log_surface(log_scales)
    log_opacity = np.minimum(log_opacity, np.log(_MAXIMUM_OPACITY))
    quaternion = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]] if len(axes) else np.zeros((0, 4))
    to_torch = lambda values: torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))  # noqa: E731
    logits, part = log_opacity - np.log1p(-np.exp(log_opacity)), to_torch(share)
    sh = part * a.all_turning().sh + (1 - part) * b.all_turning().sh
    if a.blending is Blending.LINEAR:
        radiance = [radiance_from_perceptual((0.5 + SH_DC * g.sh[0]).detach().clamp(min=0)) for g in (a, b)]
        sh[0] = (perceptual_from_radiance(part * radiance[0] + (1 - part) * radiance[1]) - 0.5) / SH_DC
    shape = map(to_torch, (mean.T, log_scales.T, quaternion.T, logits))
    merged = Gaussians(*[*shape, sh], blending=a.blending)
    if a.directional is None and b.directional is None:
        return merged
    return merged.turning(a.turns | b.turns)


def _log_surface(log_sides: Floats) -> Floats:
    """(N,) logarithm of half the surface of boxes, from those of their sides (N, 3)."""
    a, b, c = log_sides.T
    return np.logaddexp(np.logaddexp(a + b, a + c), b + c)


def _covariance(gaussians: Gaussians) -> Floats:
    turn = Rotation.from_quat(quaternions_xyzw(gaussians)).as_matrix().reshape(-1, 3, 3)
    scaled = turn * np.exp(rows_of(gaussians.log_scales))[:, None, :]
    return scaled @ scaled.transpose(0, 2, 1)


# Neighbours that are looked up at once; where more are needed, the search goes through all.
NEIGHBOURS = 16


def with_parents(below: Layer, above: Layer, parent: Ints, tries: int) -> tuple[Layer, Ints]:
    """Gives a parent to every node of a layer that has none, if necessary a new one.

    A node tries so many; the paper's algorithm tries one. Parents (N,) are indices in the layer above, -1 for
    none. Returns that layer, the new parents after the given nodes, and the parent (N,) of every node below.
    """
    parent = parent.copy()
    codes_below, codes_above = label_codes(below), label_codes(above)
    room = np.full(len(above), MAX_CHILDREN) - np.bincount(parent[parent >= 0], minlength=len(above))
    made: list[Layer] = []
    count = len(above)
    # Nodes of different labels never share a tree.
    for code in np.unique(codes_below[parent < 0]):
        children = np.flatnonzero((parent < 0) & (codes_below == code))
        candidates = np.flatnonzero(codes_above == code)
        centres = rows_of(below.gaussians.means)[children]
        order = z_curve_order(centres)
        children, centres = children[order], centres[order]
        search = _ParentSearch(centres, rows_of(above.gaussians.means)[candidates], room[candidates], tries)
        found = search.run()
        old = found < len(candidates)
        parent[children[old]] = candidates[found[old]]
        parent[children[~old]] = count + found[~old] - len(candidates)
        made.append(_made_parents(below, children[~old], parent[children[~old]] - count))
        count += len(made[-1])
    return concatenated_layers([above, *made]), parent


def label_codes(layer: Layer) -> Ints:
    """(N,) one number per node, equal for nodes with the same labels."""
    return 2 * layer.semantic.numpy().astype(np.int64) + layer.dynamic.numpy()


class _ParentSearch:
    """The loop of Algorithm 1 (lines 3 to 12): children (N, 3) choose among parents (M, 3), one by one.

    Each tries the nearest parents in turn, including those made for earlier children. If none of `tries`
    parents has room left (M,), a new one is made at the child's own position.
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
                chosen = self._given + self._count
                self._made_for[child] = self._count
                self._made[self._count] = self._children[child]
                self._count += 1
                self._room.append(MAX_CHILDREN)
            self._room[chosen] -= 1
            result[child] = chosen
        return result

    def _nearest(self, child: int) -> list[int]:
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


def _made_parents(below: Layer, children: Ints, number: Ints) -> Layer:
    """New parents: twice the size of an only child, or the moments of two.

    Children are given by indices (C,) in the layer below; `number` (C,) counts their parents without gaps.
    """
    order = np.argsort(number, kind="stable")
    children, number = children[order], number[order]
    _, first, count = np.unique(number, return_index=True, return_counts=True)
    single = below.select(torch.from_numpy(children[first]))
    gaussians = replace(single.gaussians, log_scales=single.gaussians.log_scales + float(np.log(2.0)))
    pairs = np.flatnonzero(count == MAX_CHILDREN)
    if len(pairs):
        left = below.gaussians.select(torch.from_numpy(children[first[pairs]]))
        right = below.gaussians.select(torch.from_numpy(children[first[pairs] + 1]))
        gaussians = written(gaussians, torch.from_numpy(pairs), merge(left, right))
    return without_parents(replace(single, gaussians=gaussians))


def build_forest(finest: Layer, pixel: float, layers: int) -> list[Layer]:
    """Layers, coarsest first, over the Gaussians of one trained set, which is layer L (Algorithm 1).

    They do not depend on its order. `pixel` is the size of a pixel of training frames at their mean depth.
    """
    # The sky is huge, and yet its Gaussians are as small in a frame as others.
    size = finest.gaussians.longest.numpy() / remoteness(finest.gaussians.means).numpy()
    level = layer_of_size(size, pixel, layers)
    below = without_parents(finest)
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
        forest.insert(0, below.under(parent))
        origin = np.concatenate([origin[itself], np.full(len(above) - int(itself.sum()), -1)])
        below = above
    return [below, *forest]


def layer_of_size(size: NDArray[np.floating], pixel: float, layers: int) -> Ints:
    """(N,) layer, 1 to L, that Gaussians belong to by their longest axes (N,) in world space.

    Layer L takes sizes below 4 pixels, layer l from 2^(L - l + 1) to 2^(L - l + 2) pixels, layer 1 all above:
    what a frame reduced by 2^(L - l) can still sample. (The printed upper bound 2^L s_L f d must read
    2^L s_L d / f.) `pixel` is as for `build_forest`.
    """
    octave = np.floor(np.log2(np.maximum(size / pixel, 2.0))).astype(np.int64)
    return np.clip(layers + 1 - octave, 1, layers)


def settle(layers: list[Layer]) -> list[Layer]:
    """Completes the trees over trained layers, coarsest first; new nodes come after those given.

    Parents may be missing, out of range, or too many children may share one. A child inside its parent's
    ellipsoid and with the same labels keeps its parent. The others choose the nearest parent that has room.
    A node left without children takes one from a nearby node that has two.
    """
    settled = [layers[-1]]
    for above in reversed(layers[:-1]):
        below = settled[0]
        parent = _kept_parents(below, above)
        above, parent = with_parents(below, above, parent, tries=NEIGHBOURS)
        below, parent = _with_children(below, above, parent)
        settled[:1] = above, below.under(parent)
    settled[0] = without_parents(settled[0])
    # Copies were added as children to layers that were complete already. They need children as well: copies
    # of their own, from the top down.
    for index in range(1, len(settled)):
        above, below = settled[index - 1 : index + 1]
        childless = np.setdiff1d(np.arange(len(above)), below.parent.numpy())
        if len(childless):
            copies = above.select(torch.from_numpy(childless)).under(childless)
            settled[index] = concatenated_layers([below, copies])
    return settled


def _kept_parents(below: Layer, above: Layer) -> Ints:
    """(N,) parents that children may keep, else -1: within one standard deviation, with the same labels."""
    parent = below.parent.numpy().astype(np.int64)
    known = np.flatnonzero((parent >= 0) & (parent < len(above)))
    of = parent[known]
    offset = rows_of(below.gaussians.means)[known] - rows_of(above.gaussians.means)[of]
    turn = Rotation.from_quat(quaternions_xyzw(above.gaussians)[of])
    local = turn.inv().apply(offset) if len(known) else offset
    inside = (local / np.exp(rows_of(above.gaussians.log_scales))[of]) ** 2
    codes_below, codes_above = label_codes(below), label_codes(above)
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
    _, starts, lengths = np.unique(values[order], return_index=True, return_counts=True)
    result = np.empty(len(values), dtype=np.int64)
    result[order] = np.arange(len(values)) - np.repeat(starts, lengths)
    return result


def _with_children(below: Layer, above: Layer, parent: Ints) -> tuple[Layer, Ints]:
    """Gives a child to every node above that has none: a nearby node's second child, else a copy of itself.

    The copies come after the given nodes; the second result is the parent of every node below.
    """
    parent = parent.copy()
    count = np.bincount(parent, minlength=len(above))
    codes_below, codes_above = label_codes(below), label_codes(above)
    childless = np.flatnonzero(count == 0)
    near = Neighbours(rows_of(below.gaussians.means), rows_of(above.gaussians.means)[childless], NEIGHBOURS)
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
