"""Trees are completed again after nodes were moved, added and removed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from splat.model.trees import Layer, build_forest, check_forest, settle, static_layer
from tests.splat.model.test_building import scattered
from tests.splat.samples import spheres


def with_parent(x: list[float], parent: list[int], size: float = 0.5) -> Layer:
    layer = static_layer(spheres(x, [size] * len(x)))
    return replace(layer, parent=torch.tensor(parent, dtype=torch.int32))


def test_broken_forests_are_completed():
    forest = build_forest(scattered(300, labels=2), 1.0, 4)
    rng = np.random.default_rng(5)
    broken = [
        layer.select(torch.from_numpy(np.sort(rng.permutation(len(layer))[: len(layer) * 4 // 5])))
        for layer in forest
    ]
    settled = settle(broken)
    check_forest(settled)
    for before, after in zip(broken, settled, strict=True):
        # Nodes keep their position in the layer; new ones come after them.
        assert torch.equal(after.gaussians.means[:, : len(before)], before.gaussians.means)
        assert len(after) < 1.5 * len(before)
    again = settle(settled)
    assert [len(layer) for layer in again] == [len(layer) for layer in settled]


def test_a_child_inside_its_parents_ellipsoid_stays():
    """Both lie within one standard deviation of parent 0, although others are nearer and have room."""
    above = static_layer(spheres([0.0, 3.0, 3.05], [4.0, 1.0, 1.0]))
    below = with_parent([2.9, 3.1, 3.0, 3.05, 3.06], [0, 0, 1, 2, 2])
    assert settle([above, below])[1].parent.tolist() == [0, 0, 1, 2, 2]


def test_the_ellipsoid_turns_with_its_parent():
    """Long along x, turned by 45 degrees about z: long along x = y. Child 0 lies inside, child 1 does not."""
    above = static_layer(spheres([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]))
    above.gaussians.log_scales[0, 0] = np.log(4.0)
    above.gaussians.rotations[:, 0] = torch.tensor([np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)])
    # Nearer parents for both, with one child each.
    above.gaussians.means[:2, 1:] = torch.tensor([[2.5, 2.5], [2.6, -2.6]])
    below = with_parent([2.5, 2.5, 2.5, 2.5], [0, 0, 1, 2])
    below.gaussians.means[1] = torch.tensor([2.5, -2.5, 2.6, -2.6])
    assert settle([above, below])[1].parent.tolist() == [0, 2, 1, 2]


def test_the_ellipsoid_ends_at_one_standard_deviation():
    """At distance 0.99 along a diagonal the child stays, at 1.01 it goes to the nearer parent."""
    above = static_layer(spheres([0.0, 1.0], [1.0, 0.1]))
    above.gaussians.means[1:, 1] = 1.0
    for distance, expected in ((0.99, 0), (1.01, 1)):
        below = with_parent([0.0, 0.0, 1.0], [0, 0, 1])
        below.gaussians.means[:, 0] = distance / np.sqrt(3)
        below.gaussians.means[1:, 2] = 1.0
        assert settle([above, below])[1].parent.tolist() == [expected, 0, 1]


def test_a_child_outside_goes_to_the_nearest_parent_with_room():
    above = static_layer(spheres([0.0, 5.0, 9.0], [1.0, 1.0, 1.0]))
    # 2 and 3 fill parent 1; 1 lies outside of parent 0 and must go on to parent 2.
    below = with_parent([0.0, 5.2, 5.0, 5.1, 9.0], [0, 0, 1, 1, 2])
    assert settle([above, below])[1].parent.tolist() == [0, 2, 1, 1, 2]


def test_of_too_many_children_the_nearest_stay():
    above = static_layer(spheres([0.0, 1.0], [4.0, 4.0]))
    below = with_parent([0.3, -0.1, 0.2, 1.0], [0, 0, 0, 1])
    assert settle([above, below])[1].parent.tolist() == [1, 0, 0, 1]


def test_a_node_without_children_takes_one_from_a_neighbour():
    above = static_layer(spheres([0.0, 3.0], [4.0, 1.0]))
    below = with_parent([2.9, 0.1], [0, 0])
    # The one at 2.9 is the nearest.
    assert settle([above, below])[1].parent.tolist() == [1, 0]


def test_a_node_that_finds_no_child_gets_a_copy_of_itself():
    """Its copies go all the way down; only children are not taken from their parents."""
    top = static_layer(spheres([0.0, 50.0], [4.0, 2.0]))
    middle, bottom = with_parent([0.0], [0], 2.0), with_parent([0.0], [0], 1.0)
    settled = settle([top, middle, bottom])
    check_forest(settled)
    for layer in settled[1:]:
        assert layer.gaussians.means[0].tolist() == [0, 50]
        assert layer.gaussians.log_scales.exp()[0, 1].item() == np.float32(2)
        assert layer.parent.tolist() == [0, 1]


def test_labels_never_mix():
    """A child that now belongs to another instance leaves its parent, although it lies inside."""
    above, below = static_layer(spheres([0.0], [4.0])), with_parent([0.1, 0.2], [0, 0])
    below = replace(below, semantic=torch.tensor([-1, 6], dtype=torch.int32))
    settled = settle([above, below])
    check_forest(settled)
    assert settled[1].parent.tolist() == [0, 1]
    assert settled[0].semantic.tolist() == [-1, 6]


def test_parents_out_of_range_count_as_none():
    above, below = static_layer(spheres([0.0], [1.0])), with_parent([0.1, 0.2], [17, -1])
    assert settle([above, below])[1].parent.tolist() == [0, 0]
