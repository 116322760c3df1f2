"""Layers keep Gaussians, parents and labels together."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from splat.model.trees import (
    BACKGROUND,
    NO_PARENT,
    Layer,
    build_forest,
    check_forest,
    concatenated_layers,
    static_layer,
)
from tests.splat.samples import equal, gaussians


def layer() -> Layer:
    g = gaussians(n=5, degree=0)
    number = torch.arange(5, dtype=torch.int32)
    return Layer(g, number + 10, number + 20, torch.tensor([True, False, False, True, False]))


def test_a_static_layer_has_no_parents_and_no_labels():
    made = static_layer(gaussians(n=3))
    assert len(made) == 3
    assert made.parent.tolist() == [NO_PARENT] * 3
    assert made.semantic.tolist() == [BACKGROUND] * 3
    assert made.dynamic.tolist() == [False] * 3


def test_selection_keeps_what_belongs_together():
    picked = layer().select(torch.tensor([3, 1]))
    assert equal(picked.gaussians, layer().gaussians.select(torch.tensor([3, 1])))
    assert (picked.parent.tolist(), picked.semantic.tolist()) == ([13, 11], [23, 21])
    assert picked.dynamic.tolist() == [True, False]


def test_a_part_shares_memory():
    whole = layer()
    part = whole.part(1, 4)
    assert part.parent.tolist() == [11, 12, 13]
    assert torch.equal(part.gaussians.means, whole.gaussians.means[:, 1:4])
    part.gaussians.means[0, 0] = 77
    part.semantic[2] = 99
    assert whole.gaussians.means[0, 1] == 77
    assert whole.semantic[3] == 99


def test_parts_make_up_the_whole():
    whole = layer()
    again = concatenated_layers([whole.part(0, 2), whole.part(2, 2), whole.part(2, 5)])
    assert equal(again.gaussians, whole.gaussians)
    for (name, found), (_, expected) in zip(again.labels(), whole.labels(), strict=True):
        assert torch.equal(found, expected), name


@pytest.mark.parametrize("name", ["parent", "semantic", "dynamic"])
def test_wrong_shapes_are_named(name):
    labels = dict(layer().labels()) | {name: torch.zeros(4)}
    with pytest.raises(ValueError, match=rf"{name} has shape \(4,\), expected \(5,\)"):
        Layer(layer().gaussians, **labels)


@pytest.fixture
def layers() -> list[Layer]:
    return build_forest(static_layer(gaussians(n=40, degree=0)), 0.05, 3)


def changed(layer: Layer, name: str, index: int, value: int) -> Layer:
    tensor = getattr(layer, name).clone()
    tensor[index] = value
    return replace(layer, **{name: tensor})


def test_a_built_forest_passes(layers):
    check_forest(layers)


@pytest.mark.parametrize(
    ("layer", "name", "index", "value", "complaint"),
    [
        (0, "parent", 2, 0, "a node of layer 1 has a parent"),
        (2, "parent", 7, -1, "node 7 of layer 3 has no parent"),
        (1, "parent", 3, 10_000, "node 3 of layer 2 has no parent"),
        (2, "semantic", 5, 3, "labels disagree: node 5 of layer 3"),
        (2, "dynamic", 6, True, "labels disagree: node 6 of layer 3"),
    ],
)
def test_a_broken_node_is_named(layers, layer, name, index, value, complaint):
    layers[layer] = changed(layers[layer], name, index, value)
    with pytest.raises(ValueError, match=complaint):
        check_forest(layers)


def test_too_many_and_too_few_children_are_named(layers):
    parent = torch.zeros(len(layers[1]), dtype=torch.int32)
    with pytest.raises(ValueError, match="node 1 of layer 1 has no child"):
        check_forest([layers[0], replace(layers[1], parent=parent), layers[2]])
    root, three = layers[0].part(0, 1), layers[0].part(0, 1).select(torch.zeros(3, dtype=torch.long))
    three = replace(three, parent=torch.zeros(3, dtype=torch.int32))
    with pytest.raises(ValueError, match="node 0 of layer 1 has more than 2 children"):
        check_forest([root, three])
    check_forest([root, three.part(0, 2)])


def test_a_forest_has_layers_and_nodes(layers):
    with pytest.raises(ValueError, match="zero layers"):
        check_forest([])
    with pytest.raises(ValueError, match="layer 2 holds no nodes"):
        check_forest([layers[0], layers[1].part(0, 0), layers[2]])
