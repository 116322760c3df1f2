"""Training of one layer: steps, density control, trees and checkpoints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.trees import concatenated_layers
from splat.raster.differentiable import render_differentiable
from splat.training import density
from splat.training.initialization import seed_from_views
from splat.training.layer_training import LayerTraining
from splat.training.loss import FrameTarget
from tests.splat.samples import equal
from tests.splat.training.frames import WALLS

STEPS = 30


@pytest.fixture(autouse=True)
def density_control_after_ten_steps(monkeypatch) -> None:
    monkeypatch.setattr(density, "_EVERY", 10)
    monkeypatch.setattr(density, "_CHANGES", 1)


def begun(arrays, final: int = 300) -> LayerTraining:
    training = LayerTraining(arrays, WALLS, STEPS, [5, 1])
    seeds = seed_from_views(WALLS, 150, 1, np.random.default_rng(0))
    training.begin(seeds, final)
    return training


def test_views_come_once_per_round_in_random_order(arrays):
    training = begun(arrays)
    rounds = [[training._view_of(3 * n + k) for k in range(3)] for n in range(20)]
    assert all(sorted(views) == [0, 1, 2] for views in rounds)
    assert len({tuple(views) for views in rounds}) == 6
    # The same seed gives the same order, another seed another one.
    again = begun(arrays)
    assert rounds[4] == [again._view_of(12 + k) for k in range(3)]
    other = LayerTraining(arrays, WALLS, STEPS, [6, 1])
    other.begin(seed_from_views(WALLS, 150, 1, np.random.default_rng(0)), 300)
    assert rounds != [[other._view_of(3 * n + k) for k in range(3)] for n in range(20)]


def test_steps_lower_the_loss(arrays):
    training = begun(arrays)

    def error() -> float:
        losses = []
        for view in WALLS:
            image = render_differentiable(arrays, training.layer.gaussians, view.camera)
            losses.append(FrameTarget(arrays, torch.from_numpy(view.radiance)).loss(image)[0].item())
        return sum(losses)

    before = error()
    for _ in range(9):
        assert training.step() is None
    assert training.done == 9
    assert error() < 0.9 * before


def test_density_control_says_where_nodes_have_gone(arrays):
    training = begun(arrays)
    for _ in range(9):
        assert training.step() is None
    layer = training.layer
    # Node 7 becomes invisible, but for its last step.
    training._optimizer.on_device.opacity_logits[7] = -50.0
    now = training.step()
    assert now is not None
    assert now.shape == (150,)
    assert now[7] == -1
    assert now[6] == 6
    assert now[8] == 7
    after = training.layer
    assert after.parent[now[8]] == layer.parent[8]
    # One change in 30 steps: it goes all the way from 150 to 300.
    assert len(after) == 300
    assert (after.parent == -1).all()


def test_extension_keeps_the_nodes_and_adds_new_ones(arrays):
    training = begun(arrays)
    for _ in range(3):
        training.step()
    before = training.layer
    new = seed_from_views(WALLS[:1], 4, 1, np.random.default_rng(1))
    training.extend(concatenated_layers([before, new]))
    assert len(training.layer) == 154
    assert equal(training.layer.gaussians.select(torch.arange(150)), before.gaussians)
    assert equal(training.layer.gaussians.select(torch.arange(150, 154)), new.gaussians)
    # The same nodes with other parents.
    parents = torch.arange(154, dtype=torch.int32)
    training.extend(replace(training.layer, parent=parents))
    assert torch.equal(training.layer.parent, parents)


@pytest.mark.parametrize("stop", [0, 1, 9, 10])
def test_a_restored_layer_continues_with_the_same_bits(arrays, stop):
    first = begun(arrays)
    for _ in range(stop):
        first.step()
    tensors, numbers = first.state()
    tensors = {name: tensor.clone() for name, tensor in tensors.items()}
    second = LayerTraining(arrays, WALLS, STEPS, [5, 1])
    assert not second.begun
    second.restore(tensors, numbers)
    assert second.begun
    assert second.done == stop
    for _ in range(3):
        first.step()
        second.step()
    assert equal(first.layer.gaussians, second.layer.gaussians)
    assert torch.equal(first.layer.parent, second.layer.parent)


def test_a_layer_that_has_not_begun_has_nothing_to_save(arrays):
    fresh = LayerTraining(arrays, WALLS, STEPS, [5, 1])
    assert fresh.state() == ({}, {"done": 0})
    fresh.restore(*fresh.state())
    assert not fresh.begun
