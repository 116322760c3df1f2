"""A hierarchy over Gaussians: trees of growing sizes, whose inner nodes have their children's moments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splat.model.gaussians import Blending, Gaussians
from splat.model.hierarchy import USUAL_CONTRAST, CutTree, Hierarchy, hierarchy_of
from splat.model.trees import Layer, merge, static_layer
from tests.extremes import extreme
from tests.splat.samples import gaussians


def surface(n: int = 400, seed: int = 0) -> Layer:
    """Flat Gaussians of two colours on a plane, left and right of its middle."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-1, 1, (2, n))
    means = torch.from_numpy(np.stack([*place, np.zeros(n)]).astype(np.float32))
    log_scales = torch.full((3, n), -3.0) + torch.tensor([[0.0], [0.0], [-3.0]])
    rotations = torch.tensor([[1.0], [0], [0], [0]]).repeat(1, n)
    sh = torch.where(means[0] > 0, 1.0, -1.0).repeat(1, 3, 1)
    return static_layer(Gaussians(means, log_scales, rotations, torch.full((n,), 1.0), sh))


def test_every_node_but_few_roots_has_a_parent_that_is_larger():
    layer = surface()
    hierarchy = hierarchy_of(layer)
    nodes = hierarchy.nodes(layer.gaussians)
    has = nodes.parent >= 0
    assert len(nodes.parent) == 400 + len(hierarchy)
    assert (nodes.size[nodes.parent[has]] > nodes.size[has]).all()
    assert (np.bincount(nodes.parent[has])[400:] == 2).all()
    assert np.count_nonzero(~has) == 400 - len(hierarchy) <= 4


def test_sizes_are_extents_times_contrasts_and_nested():
    leaves = surface(60).gaussians
    hierarchy = hierarchy_of(surface(60))
    contrast = torch.from_numpy(np.random.default_rng(3).lognormal(0, 2, len(hierarchy)).astype(np.float32))
    plain, nodes = hierarchy.nodes(leaves), replace(hierarchy, contrast=contrast).nodes(leaves)
    np.testing.assert_array_equal(nodes.extent, plain.extent)
    np.testing.assert_allclose(nodes.extent, nodes.gaussians.longest, rtol=1e-6)
    size = np.zeros(len(nodes.size))
    for node, parent in enumerate(nodes.parent):
        if node < 60:
            # Leaves are as those that they disappear in.
            factor = 1.0 if parent < 0 else float(contrast[parent - 60]) / USUAL_CONTRAST
            size[node] = float(nodes.extent[node]) * factor
        else:
            least = 1.1 * max(size[child] for child in hierarchy.children[node - 60].tolist())
            size[node] = max(float(nodes.extent[node]) * float(contrast[node - 60]) / USUAL_CONTRAST, least)
    np.testing.assert_allclose(nodes.size, size, rtol=1e-6)


def test_the_first_nodes_are_the_leaves_to_the_bit():
    layer = surface()
    nodes = hierarchy_of(layer).nodes(layer.gaussians)
    assert nodes.leaves == 400
    for own, leaf in zip(
        nodes.gaussians.part(0, 400).every_tensor(), layer.gaussians.every_tensor(), strict=True
    ):
        assert torch.equal(own, leaf)


@pytest.mark.parametrize("degree", [0, 2])
@pytest.mark.parametrize("blending", list(Blending))
def test_inner_nodes_are_their_children_merged(degree, blending):
    leaves = replace(gaussians("overlap", 60, degree), blending=blending)
    hierarchy = hierarchy_of(static_layer(leaves))
    nodes = hierarchy.nodes(leaves).gaussians
    left, right = (nodes.select(side.long()) for side in hierarchy.children.T)
    merged, inner = merge(left, right), nodes.part(60, len(nodes))
    assert len(inner) > 40
    for one, other in zip(inner.every_tensor(), merged.every_tensor(), strict=True):
        torch.testing.assert_close(one, other)


def test_near_ones_of_a_colour_are_joined_first():
    """The colours of the two halves hardly mix in the lower half of the nodes."""
    layer = surface()
    nodes = hierarchy_of(layer).nodes(layer.gaussians)
    mixed = np.abs(nodes.gaussians.sh[0, 0].numpy()) < 0.9
    low = nodes.size < np.median(nodes.size[400:])
    assert np.mean(mixed[400:][low[400:]]) < 0.1
    assert mixed[np.argmax(nodes.size)]


def test_gaussians_of_other_instances_are_never_joined():
    layer = surface()
    semantic = torch.arange(400, dtype=torch.int32) % 3
    hierarchy = hierarchy_of(replace(layer, semantic=semantic))
    of = np.concatenate([semantic.numpy(), np.full(len(hierarchy), -1)])
    for number, (left, right) in enumerate(hierarchy.children.tolist(), start=400):
        assert of[left] == of[right]
        of[number] = of[left]


def test_same_gaussians_same_hierarchy():
    one, other = (hierarchy_of(surface()).children for _ in range(2))
    assert torch.equal(one, other)


def test_harmonics_that_some_have_are_merged():
    leaves = gaussians("overlap", 60, 1)
    some = leaves.turning(torch.arange(60) % 3 == 0)
    hierarchy = hierarchy_of(static_layer(some))
    own = hierarchy.nodes(some).gaussians.all_turning()
    other = hierarchy.nodes(some.all_turning()).gaussians
    torch.testing.assert_close(own.sh, other.sh)


def test_progress_tells_how_many_are_joined():
    told = []
    hierarchy = hierarchy_of(surface(), lambda done, total: told.append((done, total)))
    assert told == sorted(told)
    assert told[-1] == (len(hierarchy), 400)


@extreme("hierarchy of hardly any Gaussians", given="0, 1 and 2 Gaussians", expected="0, 0 and 1 inner nodes")
def test_a_hierarchy_of_hardly_any_gaussians(got):
    layers = [static_layer(surface(2).gaussians.part(0, n)) for n in (0, 1, 2)]
    counts = [len(hierarchy_of(layer)) for layer in layers]
    assert got(counts) == [0, 0, 1]
    assert hierarchy_of(layers[0]).nodes(layers[0].gaussians).leaves == 0


@extreme("hierarchy of equal Gaussians", given="500 in one place", expected="one root")
def test_a_hierarchy_of_equal_gaussians(got):
    layer = surface(500)
    layer.gaussians.means[:] = 0.5
    layer.gaussians.sh[:] = 0
    hierarchy = hierarchy_of(layer)
    nodes = hierarchy.nodes(layer.gaussians)
    assert nodes.gaussians.is_finite()
    assert got(500 - len(hierarchy)) == 1


@pytest.mark.parametrize(
    ("children", "said"),
    [
        ([[0, 9]], "above nodes that there are not"),
        ([[0, -1]], "above nodes that there are not"),
        ([[0, 1], [1, 2]], "two parents"),
        ([[0, 0]], "two parents"),
    ],
)
def test_pairs_that_make_no_trees_are_refused(children, said):
    with pytest.raises(ValueError, match=said):
        Hierarchy(torch.tensor(children, dtype=torch.int32)).parents(4)


@st.composite
def trees(draw) -> tuple[np.ndarray, int]:
    """Parents of random binary trees, and the number of their leaves."""
    leaves = draw(st.integers(0, 30))
    free, parent = list(range(leaves)), [-1] * leaves
    joined = draw(st.integers(0, max(0, leaves - 1)))
    for node in range(leaves, leaves + joined):
        for _ in range(2):
            parent[free.pop(draw(st.integers(0, len(free) - 1)))] = node
        free.append(node)
        parent.append(-1)
    return np.array(parent, dtype=np.int32), leaves


def line(parent: np.ndarray, node: int) -> list[int]:
    """A node and all above it, upwards."""
    found = []
    while node >= 0:
        found.append(node)
        node = int(parent[node])
    return found


@given(trees(), st.randoms(use_true_random=False))
def test_any_split_makes_a_complete_cut(tree, random):
    parent, leaves = tree
    found = CutTree(parent, leaves)
    split = np.array([random.random() < 0.7 for _ in range(found.inner)], dtype=bool)
    drawn, closed = found.drawn(split), found.closed(split)
    for leaf in range(leaves):
        assert sum(drawn[node] for node in line(parent, leaf)) == 1
    for node in range(found.inner):
        above = [n - leaves for n in line(parent, node + leaves)]
        assert closed[node] == all(split[n] for n in above)
    # What is below a node that is not split changes nothing.
    assert np.array_equal(found.drawn(closed), drawn)
    assert np.count_nonzero(drawn) == found.roots + np.count_nonzero(closed)


@given(trees(), st.randoms(use_true_random=False))
def test_values_fall_on_the_way_down(tree, random):
    parent, leaves = tree
    found = CutTree(parent, leaves)
    values = np.array([random.uniform(-1, 1) for _ in range(found.inner)], dtype=np.float32)
    fallen = found.falling(values)
    for node in range(found.inner):
        assert fallen[node] == min(values[n - leaves] for n in line(parent, node + leaves))


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_nothing_split_draws_roots_and_everything_split_leaves(share):
    layer = surface()
    nodes = hierarchy_of(layer).nodes(layer.gaussians)
    tree = CutTree(nodes.parent, nodes.leaves)
    drawn = tree.drawn(np.full(tree.inner, share > 0))
    expected = nodes.parent < 0 if share == 0 else np.arange(len(drawn)) < nodes.leaves
    assert np.array_equal(drawn, expected)


def test_siblings_have_the_same_parent():
    layer = surface(50)
    nodes = hierarchy_of(layer).nodes(layer.gaussians)
    other, own = nodes.siblings(), np.arange(len(nodes.parent))
    is_root = nodes.parent < 0
    assert np.array_equal(other == own, is_root)
    assert np.array_equal(nodes.parent[other], nodes.parent)
    assert np.array_equal(other[other], own)
