"""Broken trees are refused, and the node is named."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from splat.model.layer import Layer, check_forest, static_layer
from splat.model.trees import build_forest
from tests.splat.samples import gaussians


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
