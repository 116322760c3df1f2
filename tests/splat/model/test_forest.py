"""Algorithm 1 on paper, moments, and trees that stay complete."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splat.model.building import build_forest, children_of, layer_of_size
from splat.model.check import check_forest
from splat.model.forest import Layer, static_layer
from splat.model.gaussians import Gaussians
from splat.model.merging import merge
from splat.model.settling import settle


def spheres(x: list[float], size: list[float], opacity: float = 0.5) -> Gaussians:
    """Round Gaussians on the x axis."""
    n = len(x)
    means = torch.zeros(3, n)
    means[0] = torch.tensor(x)
    return Gaussians(
        means,
        torch.log(torch.tensor(size)).expand(3, n).clone(),
        torch.tensor([[1.0], [0], [0], [0]]).expand(4, n).clone(),
        torch.full((n,), float(np.log(opacity / (1 - opacity)))),
        torch.arange(n, dtype=torch.float32).expand(1, 3, n).clone(),
    )


def scattered(n: int, seed: int = 0, labels: int = 1) -> Layer:
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


def test_algorithm_1_on_a_dozen_gaussians():
    """By hand, in pixels, L = 3: sizes below 4 in layer 3, 4 to 8 in layer 2, 8 and more in layer 1.

    Ten small ones on a line, from left to right 0..9 at the places below, one of size 5 at 20.4 and one
    of size 9 at 41.5. The order is that of the line.

    Layer 3 to 2. The one of size 5 stands in layer 2 as p0 and is its own child in layer 3, the one of
    size 9 likewise as p1; each can take one more. 0 finds p0, 20 away, with room: its child. 1 finds p0
    full and makes p2 at 1. 2 at 2 finds p2, with room. 3 at 10: p2 at 1 is nearest and full, makes p3.
    4 at 10.5 joins p3. 5 at 20 finds p0, full, makes p4; 6 at 21 finds p0 at 0.6 before p4 at 1: full,
    makes p5. 7 at 40 finds p1: joins. 8 at 41 finds p1, full, makes p6; 9 at 43 finds p1 at 1.5 before p6
    at 2: full, makes p7.
    """
    places = [0.0, 1.0, 2.0, 10.0, 10.5, 20.0, 21.0, 40.0, 41.0, 43.0]
    g = spheres([*places, 20.4, 41.5], [1.0] * 10 + [5.0, 9.0])
    layers = build_forest(static_layer(g), 1.0, 3)
    check_forest(layers)
    parent = layers[2].parent.tolist()
    # Parents 0 and 1 are the two large ones themselves; the rest in the order in which they were made.
    assert parent == [0, 2, 2, 3, 3, 4, 5, 1, 6, 7, 0, 1]
    middle = layers[1].gaussians
    np.testing.assert_allclose(middle.means[0], [20.4, 41.5, 1.5, 10.25, 20.0, 21.0, 41.0, 43.0], atol=1e-5)
    size = middle.log_scales.exp().max(dim=0).values
    # Only children: twice their size. Two: moments, here of two points half a pixel apart from their mean.
    np.testing.assert_allclose(size, [5, 9, 1.25**0.5, (1 + 0.25**2) ** 0.5, 2, 2, 2, 2], rtol=1e-5)
    # Layer 2 to 1: the one of size 9 is its own child there; the other one has class 2.
    assert layers[1].parent[1].item() == 0
    assert layers[0].gaussians.log_scales.exp().max(dim=0).values[0] == pytest.approx(9)


def test_the_smaller_child_is_the_left_one():
    above = static_layer(spheres([0.0, 5.0], [4.0, 4.0]))
    below = static_layer(spheres([0.0, 0.1, 5.0], [2.0, 1.0, 1.0]))
    below = Layer(below.gaussians, torch.tensor([0, 0, 1], dtype=torch.int32), below.semantic, below.dynamic)
    assert children_of(above, below).tolist() == [[1, 0], [2, -1]]


def test_a_merged_parent_has_the_moments_of_its_children():
    """Spheres of sd 1 at 0 and of sd 2 at 3, opacities 0.8 and 0.5.

    S = 3 and 12, w = 2.4 and 6, shares 2/7 and 5/7: mean 15/7; variance across 2/7 + 20/7 = 22/7, along it
    (2/7) (1 + (15/7)^2) + (5/7) (4 + (6/7)^2) = 22/7 + 90/49 = 244/49.
    """
    a, b = spheres([0.0], [1.0], 0.8), spheres([3.0], [2.0], 0.5)
    b.sh[:] = 7.0
    parent = merge(a, b)
    assert parent.means[:, 0].tolist() == pytest.approx([15 / 7, 0, 0], abs=1e-6)
    deviation = np.sort(parent.log_scales[:, 0].exp().numpy())
    np.testing.assert_allclose(deviation**2, [22 / 7, 22 / 7, 244 / 49], rtol=1e-5)
    s1, s2, s3 = np.sqrt([22 / 7, 22 / 7, 244 / 49])
    expected = (2.4 + 6) / (s1 * s2 + s1 * s3 + s2 * s3)
    assert torch.sigmoid(parent.opacity_logits)[0].item() == pytest.approx(expected, rel=1e-5)
    assert parent.sh[0, 0, 0].item() == pytest.approx(5, rel=1e-5)


def test_an_opacity_above_one_is_cut_off():
    a, b = spheres([0.0], [1.0], 0.9), spheres([0.0], [1.0], 0.9)
    assert torch.sigmoid(merge(a, b).opacity_logits)[0].item() == pytest.approx(0.99, abs=1e-4)


def test_turned_children_give_their_covariance():
    """Sum of covariances, against the definition with dense matrices."""
    rng = np.random.default_rng(3)
    normal = lambda *shape: torch.from_numpy(rng.normal(size=shape).astype(np.float32))  # noqa: E731
    parts = [
        Gaussians(normal(3, 5), normal(3, 5) * 0.3, normal(4, 5), normal(5), normal(4, 3, 5))
        for _ in range(2)
    ]
    from tests.splat.raster.reference import rotation_matrix

    def covariance(g: Gaussians) -> torch.Tensor:
        M = rotation_matrix(g.rotations.double()) @ torch.diag_embed(g.log_scales.double().exp().T)
        return M @ M.transpose(1, 2)

    weights = []
    for g in parts:
        s = g.log_scales.double().exp()
        weights.append(torch.sigmoid(g.opacity_logits.double()) * (s[0] * s[1] + s[0] * s[2] + s[1] * s[2]))
    shares = [w / sum(weights) for w in weights]
    mean = sum(share * g.means.double() for share, g in zip(shares, parts, strict=True))
    expected = 0
    for share, g in zip(shares, parts, strict=True):
        d = (g.means.double() - mean).T
        expected = expected + share[:, None, None] * (covariance(g) + d[:, :, None] * d[:, None, :])
    torch.testing.assert_close(covariance(merge(*parts)), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("layers", [1, 2, 4, 6])
@pytest.mark.parametrize("labels", [1, 3])
def test_every_tree_is_complete_and_of_one_label(layers, labels):
    forest = build_forest(scattered(300, labels=labels), 1.0, layers)
    assert len(forest) == layers
    check_forest(forest)
    # The finest layer is what was given.
    assert torch.equal(forest[-1].gaussians.means, scattered(300, labels=labels).gaussians.means)


def test_the_order_in_memory_does_not_matter():
    layer = scattered(200)
    shuffled = torch.from_numpy(np.random.default_rng(1).permutation(200))
    first, second = build_forest(layer, 1.0, 4), build_forest(layer.select(shuffled), 1.0, 4)
    for a, b in zip(first, second, strict=True):
        assert len(a) == len(b)
        left, right = (np.sort(x.gaussians.means.numpy().T.copy(), axis=0) for x in (a, b))
        np.testing.assert_allclose(left, right, atol=1e-5)


def test_one_gaussian_and_many_in_one_place():
    check_forest(build_forest(scattered(1), 1.0, 4))
    heap = scattered(50)
    heap.gaussians.means[:] = 1.0
    check_forest(build_forest(heap, 1.0, 4))


def test_settling_keeps_good_parents_and_mends_the_rest():
    forest = build_forest(scattered(300, labels=2), 1.0, 4)
    rng = np.random.default_rng(5)
    broken = [
        layer.select(torch.from_numpy(np.sort(rng.permutation(len(layer))[: len(layer) * 4 // 5])))
        for layer in forest
    ]
    settled = settle(broken)
    check_forest(settled)
    for before, after in zip(broken, settled, strict=True):
        # Nodes stay where they are in the layer; new ones come after them.
        assert torch.equal(after.gaussians.means[:, : len(before)], before.gaussians.means)
        assert len(after) < 1.5 * len(before)
    whole = settle(settled)
    assert [len(layer) for layer in whole] == [len(layer) for layer in settled]


def test_a_child_inside_its_parents_ellipsoid_stays():
    above = static_layer(spheres([0.0, 3.0], [4.0, 1.0]))
    below = static_layer(spheres([2.9, 3.1], [0.5, 0.5]))
    # Both lie inside the first one, at less than one standard deviation, though the second is nearer.
    below = Layer(below.gaussians, torch.tensor([0, 0], dtype=torch.int32), below.semantic, below.dynamic)
    settled = settle([above, below])
    # One of them has to go over to the second, which would have no child.
    assert sorted(settled[1].parent.tolist()) == [0, 1]
    wide = static_layer(spheres([0.0], [4.0]))
    assert settle([wide, below])[1].parent.tolist() == [0, 0]
