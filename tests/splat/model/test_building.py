"""Algorithm 1 by hand, and trees that are complete."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch

from splat.model.trees import Layer, build_forest, check_forest, layer_of_size, static_layer
from tests.splat.samples import equal, spheres


def scattered(n: int, seed: int = 0, labels: int = 1) -> Layer:
    """Spheres of many sizes in a cube, of one label or of several."""
    rng = np.random.default_rng(seed)
    layer = static_layer(spheres([0.0] * n, rng.uniform(0.5, 12, n).tolist()))
    layer.gaussians.means[:] = torch.from_numpy(rng.uniform(-50, 50, (3, n)).astype(np.float32))
    instance = torch.from_numpy(rng.integers(0, labels, n).astype(np.int32)) - 1
    return Layer(layer.gaussians, layer.parent, instance, instance >= 1)


def test_layer_intervals():
    """d/f = 0.5, L = 4: below 4 px, that is 2, layer 4; then 2..4, 4..8, and layer 1 from 8 on."""
    size = np.array([0.001, 1.0, 1.99, 2.0, 3.99, 4.0, 7.99, 8.0, 1000.0])
    assert layer_of_size(size, 0.5, 4).tolist() == [4, 4, 4, 3, 3, 2, 2, 1, 1]
    assert layer_of_size(size, 0.5, 1).tolist() == [1] * 9


def test_the_size_is_the_longest_axis():
    g = spheres([0.0, 1.0], [2.0, 3.0])
    g.log_scales[1, 1] = np.log(7.0)
    np.testing.assert_allclose(g.longest, [2, 7], rtol=1e-6)


def test_algorithm_1_on_a_dozen_gaussians():
    """By hand, in pixels, L = 3: sizes below 4 in layer 3, 4 to 8 in layer 2, 8 and more in layer 1.

    Ten small ones on a line, from left to right 0..9 at the positions below, one of size 5 at 20.4 and one
    of size 9 at 41.5. They choose in the order of the line.

    Layer 3 to 2. The one of size 5 stands in layer 2 as p0 and is its own child in layer 3, the one of
    size 9 likewise as p1; each can take one more. 0 finds p0, 20 away, with room: its child. 1 finds p0
    full and makes p2 at 1. 2 at 2 finds p2, with room. 3 at 10: p2 at 1 is nearest and full, makes p3.
    4 at 10.5 joins p3. 5 at 20 finds p0, full, makes p4; 6 at 21 finds p0 at 0.6 before p4 at 1: full,
    makes p5. 7 at 40 finds p1: joins. 8 at 41 finds p1, full, makes p6; 9 at 43 finds p1 at 1.5 before p6
    at 2: full, makes p7.
    """
    positions = [0.0, 1.0, 2.0, 10.0, 10.5, 20.0, 21.0, 40.0, 41.0, 43.0]
    g = spheres([*positions, 20.4, 41.5], [1.0] * 10 + [5.0, 9.0])
    layers = build_forest(static_layer(g), 1.0, 3)
    check_forest(layers)
    # Parents 0 and 1 are the two large ones themselves; the others follow in the order they were made in.
    assert layers[2].parent.tolist() == [0, 2, 2, 3, 3, 4, 5, 1, 6, 7, 0, 1]
    middle = layers[1].gaussians
    np.testing.assert_allclose(middle.means[0], [20.4, 41.5, 1.5, 10.25, 20.0, 21.0, 41.0, 43.0], atol=1e-5)
    size = middle.log_scales.exp().max(dim=0).values
    # Only children: twice their size. Two: moments, here of two points half a pixel apart from their mean.
    np.testing.assert_allclose(size, [5, 9, 1.25**0.5, (1 + 0.25**2) ** 0.5, 2, 2, 2, 2], rtol=1e-5)
    # Layer 2 to 1: the one of size 9 is its own child there; the other one has class 2.
    assert layers[1].parent[1].item() == 0
    assert layers[0].gaussians.log_scales.exp().max(dim=0).values[0] == pytest.approx(9)


@pytest.mark.parametrize("layers", [1, 2, 4, 6])
@pytest.mark.parametrize("labels", [1, 3])
def test_every_tree_is_complete_and_of_one_label(layers, labels):
    given = scattered(300, labels=labels)
    forest = build_forest(given, 1.0, layers)
    assert len(forest) == layers
    check_forest(forest)
    assert equal(forest[-1].gaussians, given.gaussians)
    # Binary trees need at least half the nodes, and more of them are shared the coarser the layer is.
    for above, below in pairwise(forest):
        assert len(below) / 2 <= len(above) <= len(below)


def test_new_parents_get_parents_of_their_own():
    """By hand, in pixels, L = 3: one of size 9 at 0, which is in all layers, and four of size 1.

    Layer 3 to 2: 100 joins the large one, 101 makes p1, 102 joins it, 103 makes p2. Layer 2 to 1: p1 joins
    the large one, p2 makes a parent. An only child's parent is twice its size: 2, then 4.
    """
    layers = build_forest(static_layer(spheres([0.0, 100.0, 101.0, 102.0, 103.0], [9.0, 1, 1, 1, 1])), 1.0, 3)
    assert [layer.parent.tolist() for layer in layers] == [[-1, -1], [0, 0, 1], [0, 0, 1, 1, 2]]
    np.testing.assert_allclose(layers[1].gaussians.longest, [9, 1.25**0.5, 2], rtol=1e-5)
    np.testing.assert_allclose(layers[0].gaussians.longest, [9, 4], rtol=1e-5)


def test_large_gaussians_are_in_all_finer_layers():
    """A Gaussian of class l is a node of layers l to L, its own only ancestor there."""
    given = scattered(200)
    level = layer_of_size(given.gaussians.longest.numpy(), 1.0, 4)
    forest = build_forest(given, 1.0, 4)
    for k in np.flatnonzero(level <= 2)[:20]:
        node, mean = k, given.gaussians.means[:, k]
        for layer in (4, 3):
            node = int(forest[layer - 1].parent[node])
            assert torch.equal(forest[layer - 2].gaussians.means[:, node], mean)


def test_the_order_in_memory_does_not_matter():
    layer = scattered(200)
    shuffled = torch.from_numpy(np.random.default_rng(1).permutation(200))
    first, second = build_forest(layer, 1.0, 4), build_forest(layer.select(shuffled), 1.0, 4)
    for a, b in zip(first, second, strict=True):
        assert len(a) == len(b)
        left, right = (np.sort(x.gaussians.means.numpy().T.copy(), axis=0) for x in (a, b))
        np.testing.assert_allclose(left, right, atol=1e-5)


def test_one_gaussian_and_many_at_one_position():
    check_forest(build_forest(scattered(1), 1.0, 4))
    heap = scattered(50)
    heap.gaussians.means[:] = 1.0
    check_forest(build_forest(heap, 1.0, 4))
