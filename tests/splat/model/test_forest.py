"""A forest holds its layers in one block of memory, sorted for locality."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.forest import Forest, forest_of
from splat.model.gaussians import Blending
from splat.model.trees import Layer, build_forest, check_forest, static_layer
from tests.splat.samples import equal, gaussians


@pytest.fixture
def layers() -> list[Layer]:
    return build_forest(static_layer(gaussians(n=60, degree=1)), 0.05, 3)


def test_layers_share_the_forests_memory(layers):
    forest = forest_of(layers, 120.0, "room", "ab")
    assert forest.counts == tuple(len(layer) for layer in layers)
    assert sum(forest.counts) == len(forest.nodes)
    first = 0
    for layer, count in zip(forest.layers, forest.counts, strict=True):
        assert torch.equal(layer.gaussians.means, forest.nodes.gaussians.means[:, first : first + count])
        first += count
    assert forest.layers[0].gaussians.sh.data_ptr() == forest.nodes.gaussians.sh.data_ptr()
    assert equal(forest.finest, forest.layers[-1].gaussians)


def test_sorting_keeps_the_trees(layers):
    """Each child keeps its parent, by position in space, and the nodes are the same."""
    forest = forest_of(layers, 120.0, "", "")
    check_forest(forest.layers)

    def pairs(above: Layer, below: Layer) -> set[tuple[float, ...]]:
        parents = above.gaussians.means[:, below.parent.long()]
        return {tuple(row) for row in torch.cat([below.gaussians.means, parents]).T.tolist()}

    for n in (1, 2):
        assert pairs(forest.layers[n - 1], forest.layers[n]) == pairs(layers[n - 1], layers[n])


def test_neighbours_in_memory_are_neighbours_in_space(layers):
    """The path through all nodes is much shorter than in a random order."""
    path = lambda means: np.linalg.norm(np.diff(means.numpy(), axis=1), axis=0).sum()  # noqa: E731
    forest = forest_of(layers, 120.0, "", "")
    assert path(forest.finest.means) < 0.7 * path(layers[-1].gaussians.means)


def test_coarser_layers_had_smaller_frames(layers):
    forest = forest_of(layers, 120.0, "", "")
    assert [forest.focal_of(layer) for layer in (1, 2, 3)] == [30, 60, 120]


def test_the_digest_tells_forests_apart(layers):
    forest = forest_of(layers, 120.0, "room", "ab")
    assert forest.digest() == forest_of(layers, 120.0, "kitchen", "cd").digest()
    others = [replace(forest, trained_focal=60.0), replace(forest, attached={"a": torch.zeros(2)})]
    blended = replace(forest.nodes.gaussians, blending=Blending.DISPLAY)
    others.append(replace(forest, nodes=replace(forest.nodes, gaussians=blended)))
    others.append(replace(forest, counts=(*forest.counts[:-2], sum(forest.counts[-2:]))))
    for name, tensor in forest.nodes.gaussians.tensors():
        moved = {n: t.clone() for n, t in forest.nodes.gaussians.tensors()}
        moved[name].view(-1)[-1] += tensor.abs().max()
        others.append(replace(forest, nodes=replace(forest.nodes, gaussians=type(forest.finest)(**moved))))
    digests = [other.digest() for other in (forest, *others)]
    assert len(set(digests)) == len(digests)


def test_counts_must_sum_to_the_nodes(layers):
    nodes = layers[-1]
    with pytest.raises(ValueError, match="zero layers"):
        Forest(nodes, (), 1.0, "", "")
    with pytest.raises(ValueError, match=rf"layers of \(3,\) nodes do not make up {len(nodes)}"):
        Forest(nodes, (3,), 1.0, "", "")
