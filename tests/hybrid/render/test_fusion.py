"""The fusion network in a forest."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from compose.base.errors import UserError
from compose.fusion.network import Fusion
from hybrid.render.forest_attachments import attach_fusion, fusion_of
from splat.io.forest_file import load_forest, save_forest
from tests.hybrid.forests import white_dot


@pytest.fixture
def fitted():
    """A forest with a network that differs from a new one."""
    torch.manual_seed(3)
    fusion = Fusion()
    with torch.no_grad():
        for parameter in fusion.parameters():
            parameter += torch.rand_like(parameter)
    return fusion, attach_fusion(white_dot((0, 0, 1)), fusion)


def test_a_forest_has_no_network_before_one_is_attached():
    assert fusion_of(white_dot((0, 0, 1))) is None


def test_a_network_goes_through_the_forests_file(fitted, tmp_path):
    fusion, forest = fitted
    save_forest(tmp_path / "a.forest", forest)
    found = fusion_of(load_forest(tmp_path / "a.forest"))
    for name, tensor in fusion.state_dict().items():
        assert torch.equal(tensor, found.state_dict()[name])


def test_the_network_of_a_forest_is_ready_for_use(fitted):
    found = fusion_of(fitted[1])
    assert not found.training
    assert not any(parameter.requires_grad for parameter in found.parameters())


def test_attaching_copies_the_weights_and_leaves_the_forest_as_it_was(fitted):
    fusion, _ = fitted
    forest = white_dot((0, 0, 1))
    attached = attach_fusion(forest, fusion)
    before = fusion_of(attached).state_dict()
    with torch.no_grad():
        for parameter in fusion.parameters():
            parameter.zero_()
    after = fusion_of(attached).state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    assert not forest.attached


def test_other_tensors_of_a_forest_are_no_network():
    forest = replace(white_dot((0, 0, 1)), attached={"deformation.weight": torch.zeros(3)})
    assert fusion_of(forest) is None


def test_a_network_of_another_shape_is_refused():
    forest = replace(white_dot((0, 0, 1)), attached={"fusion.reduce.weight": torch.zeros(3)})
    with pytest.raises(UserError, match="fusion network is damaged or of another version; train the forest"):
        fusion_of(forest)


def test_a_network_with_a_weight_that_is_not_finite_is_refused(fitted):
    _, forest = fitted
    name = next(name for name, tensor in forest.attached.items() if tensor.is_floating_point())
    forest.attached[name].view(-1)[0] = float("nan")
    with pytest.raises(UserError, match="weights that are not finite; train the forest again"):
        fusion_of(forest)
