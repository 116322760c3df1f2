"""Layers keep Gaussians, parents and labels together."""

from __future__ import annotations

import pytest
import torch

from splat.model.layer import BACKGROUND, NO_PARENT, Layer, concatenated_layers, static_layer
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
