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
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from splat.gaussians import Gaussians, concatenated

NO_PARENT = -1
BACKGROUND = -1
MAX_CHILDREN = 2
# Neighbours that are looked up at once; where none of them will do, the search goes through all.
_NEIGHBOURS = 16
_MAXIMUM_OPACITY = 0.99
_LABELS = ("parent", "semantic", "dynamic")
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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
        order = _along_z_curve(_means(layer))
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


def check_forest(layers: list[Layer]) -> None:
    """Whether all trees are complete: L layers, one or two children everywhere, labels all the same.

    Raises:
        ValueError: says which tree is broken, and how. Layers are counted from 1, the coarsest.
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
        above, parent = _with_parents(below, above, parent, tries=1)
        forest.insert(0, replace(below, parent=torch.from_numpy(parent.astype(np.int32))))
        origin = np.concatenate([origin[itself], np.full(len(above) - int(itself.sum()), -1)])
        below = above
    return [below, *forest]


def settle(layers: list[Layer]) -> list[Layer]:
    """Complete trees over layers whose nodes have moved, come and gone (Fov-GS, section 3.3).

    A child inside its parent's ellipsoid with the same labels stays. The others look for the nearest
    parent that has room. A node left without children takes over a near one whose parent has two.
    """
    settled = [layers[-1]]
    for above in reversed(layers[:-1]):
        below = settled[0]
        parent = _kept_parents(below, above)
        above, parent = _with_parents(below, above, parent, tries=_NEIGHBOURS)
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
    offset = _means(below)[known] - _means(above)[of]
    turn = Rotation.from_quat(_xyzw(above.gaussians)[of])
    local = turn.inv().apply(offset) if len(known) else offset
    inside = (local / np.exp(_rows(above.gaussians.log_scales))[of]) ** 2
    codes_below, codes_above = _label_codes(below, above)
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


def _with_parents(below: Layer, above: Layer, parent: Ints, tries: int) -> tuple[Layer, Ints]:
    """Gives a parent to every node that has none; those that had to be made are added to the layer above.

    Returns:
        The layer above, and the parent (N,) of every node below.
    """
    parent = parent.copy()
    codes_below, codes_above = _label_codes(below, above)
    room = np.full(len(above), MAX_CHILDREN) - np.bincount(parent[parent >= 0], minlength=len(above))
    made: list[Layer] = []
    count = len(above)
    # Nodes of different labels never meet: each label is a forest of its own.
    for code in np.unique(codes_below[parent < 0]):
        children = np.flatnonzero((parent < 0) & (codes_below == code))
        candidates = np.flatnonzero(codes_above == code)
        centres = _means(below)[children]
        order = _along_z_curve(centres)
        children, centres = children[order], centres[order]
        found = _search_parents(centres, _means(above)[candidates], room[candidates], tries)
        old = found < len(candidates)
        parent[children[old]] = candidates[found[old]]
        parent[children[~old]] = count + found[~old] - len(candidates)
        made.append(_made_parents(below, children[~old], parent[children[~old]] - count))
        count += len(made[-1])
    return joined([above, *made]), parent


def _with_children(below: Layer, above: Layer, parent: Ints) -> tuple[Layer, Ints]:
    """Gives a child to every node above that has none: a near one whose parent has two, else a copy."""
    parent = parent.copy()
    count = np.bincount(parent, minlength=len(above))
    codes_below, codes_above = _label_codes(below, above)
    childless = np.flatnonzero(count == 0)
    near = _Neighbours(_means(below), _means(above)[childless], _NEIGHBOURS)
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
    given = _Neighbours(parents, children, tries)
    near = _Neighbours(children, children, _NEIGHBOURS + 1)
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


class _Neighbours:
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


def merge(a: Gaussians, b: Gaussians) -> Gaussians:
    """One Gaussian with the moments of two, for N pairs.

    Weights w = o S with o the opacity and S = s1 s2 + s1 s3 + s2 s3, half the surface of a box with the
    standard deviations as sides. Mean, covariance and colour are weighted by w; the opacity is
    (w_a + w_b) / S of the result, at most 0.99.
    """
    weight_a, weight_b = (_opacity(g) * _surface(np.exp(_rows(g.log_scales))) for g in (a, b))
    share = weight_a / (weight_a + weight_b)
    mean_a, mean_b = _rows(a.means), _rows(b.means)
    mean = share[:, None] * mean_a + (1 - share)[:, None] * mean_b
    covariance = sum(
        part[:, None, None] * (_covariance(g) + np.einsum("ni,nj->nij", centre - mean, centre - mean))
        for part, g, centre in ((share, a, mean_a), (1 - share, b, mean_b))
    )
    variance, axes = np.linalg.eigh(covariance)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    deviation = np.sqrt(np.maximum(variance, 1e-20))
    opacity = np.minimum((weight_a + weight_b) / _surface(deviation), _MAXIMUM_OPACITY)
    quaternion = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]] if len(axes) else np.zeros((0, 4))
    to_torch = lambda values: torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))  # noqa: E731
    part = to_torch(share)
    return Gaussians(
        to_torch(mean.T),
        to_torch(np.log(deviation).T),
        to_torch(quaternion.T),
        to_torch(np.log(opacity / (1 - opacity))),
        part * a.sh + (1 - part) * b.sh,
    )


def _rows(tensor: torch.Tensor) -> Floats:
    return tensor.detach().numpy().T.astype(np.float64)


def _means(layer: Layer) -> Floats:
    return _rows(layer.gaussians.means)


def _opacity(gaussians: Gaussians) -> Floats:
    return 1 / (1 + np.exp(-gaussians.opacity_logits.detach().numpy().astype(np.float64)))


def _surface(deviation: Floats) -> Floats:
    a, b, c = deviation.T
    return a * b + a * c + b * c


def _xyzw(gaussians: Gaussians) -> Floats:
    return _rows(gaussians.rotations)[:, [1, 2, 3, 0]]


def _covariance(gaussians: Gaussians) -> Floats:
    turn = Rotation.from_quat(_xyzw(gaussians)).as_matrix().reshape(-1, 3, 3)
    scaled = turn * np.exp(_rows(gaussians.log_scales))[:, None, :]
    return scaled @ scaled.transpose(0, 2, 1)


def _label_codes(below: Layer, above: Layer) -> tuple[Ints, Ints]:
    """One number per node, the same for nodes with the same labels."""
    codes = [2 * layer.semantic.numpy().astype(np.int64) + layer.dynamic.numpy() for layer in (below, above)]
    return codes[0], codes[1]


def _along_z_curve(points: Floats) -> Ints:
    """Order (N,) in which neighbours in space mostly follow each other (Morton 1966)."""
    # A training gone wrong is refused elsewhere; here its points only need some place.
    points = np.nan_to_num(points)
    low = points.min(axis=0)
    extent = max(float((points.max(axis=0) - low).max()), 1e-30)
    cell = ((points - low) / extent * (2**20 - 1)).astype(np.uint64)
    key = np.zeros(len(points), dtype=np.uint64)
    for bit in range(20):
        for axis in range(3):
            key |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    # Equal keys in the order of the coordinates, so that the order in memory does not matter.
    return np.lexsort((points[:, 2], points[:, 1], points[:, 0], key))
