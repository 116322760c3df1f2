"""Checks that all trees of a forest are complete."""

from __future__ import annotations

import torch

from splat.model.layer import MAX_CHILDREN, NO_PARENT, Layer


def check_forest(layers: list[Layer]) -> None:
    """Checks that each node has a parent and one or two children, all with the same labels.

    Args:
        layers: coarsest first.

    Raises:
        ValueError: says which node is wrong, and how. Layers are counted from 1, the coarsest.
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
        _check_pair(layers[number - 2], layer, number)


def _check_pair(above: Layer, layer: Layer, number: int) -> None:
    """Checks a layer against the next coarser one."""
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
