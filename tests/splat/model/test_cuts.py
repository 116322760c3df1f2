"""Complete cuts: whatever is split, every leaf has exactly one drawn node above it, or is it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splat.model.cuts import CutTree
from splat.model.hierarchy import hierarchy_of
from tests.splat.model.test_hierarchy import surface


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
