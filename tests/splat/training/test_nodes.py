"""Nodes are told by what they contribute to, not by how they were labelled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from compose.camera.camera import camera_from_pose
from splat.model.gaussians import Gaussians
from splat.model.motion import NodeMotion
from splat.model.trees import BACKGROUND, concatenated_layers, static_layer
from splat.training.moving_nodes import evidence_of, separated
from splat.training.training_view import TrainingView

SIZE, WAY = 32, 0.8
POSE = np.eye(4)
POSE[2, 3] = -3
CAMERA = camera_from_pose(POSE, SIZE, SIZE, 40, 40, SIZE / 2, SIZE / 2)
ONE = torch.ones(1, dtype=torch.int64)
ROTATIONS = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64).repeat(2, 1, 1)
MOTION = NodeMotion(
    ROTATIONS,
    torch.zeros(1, 3, dtype=torch.float64),
    torch.tensor([[[0.0, 0, 0]], [[WAY, 0, 0]]], dtype=torch.float64),
    ONE,
)


def row_of_nodes(xs: list[float], z: float) -> Gaussians:
    """Round nodes side by side that hide what is behind them."""
    n = len(xs)
    means = torch.tensor([xs, [0.0] * n, [z] * n])
    rotations = torch.tensor([[1.0], [0], [0], [0]]).repeat(1, n)
    return Gaussians(means, torch.full((3, n), -2.5), rotations, torch.full((n,), 4.0), torch.zeros(1, 3, n))


def view(time: float) -> TrainingView:
    """What is left of the middle and before it moves to the right."""
    labels = np.full((SIZE, SIZE), BACKGROUND, dtype=np.int32)
    x = np.arange(SIZE) + 0.5
    place = (x - SIZE / 2) / 40 * 2
    labels[:, (place > -0.75 + WAY * time) & (place < -0.25 + WAY * time)] = 0
    depth = np.where(labels == BACKGROUND, 3.0, 2.0).reshape(-1)
    cosine = CAMERA.rays(CAMERA.pixel_centres())[:, 2]
    distance = (depth / cosine).reshape(SIZE, SIZE).astype(np.float32)
    normal = np.tile(np.float32([0, 0, -1]), (SIZE, SIZE, 1))
    return TrainingView(CAMERA, np.zeros_like(normal), distance, normal, time=time, instance=labels)


STILL = np.linspace(-1.2, 1.2, 25).round(3).tolist()
MOVING = [-0.6, -0.45, -0.3]
VIEWS = [view(time) for time in (0.0, 0.5, 1.0)]


def test_labels_follow_what_nodes_contribute_to(arrays):
    """A mover's nodes that were taken for still, and one of the background that was taken for moving."""
    wall, card = static_layer(row_of_nodes(STILL, 0.0)), static_layer(row_of_nodes(MOVING, -1.0))
    wrong = torch.zeros(len(STILL), dtype=torch.bool)
    wrong[-4] = True
    wall = replace(wall, semantic=torch.where(wrong, 0, BACKGROUND).int(), dynamic=wrong)
    moving = torch.tensor([0, 0, BACKGROUND], dtype=torch.int32)
    card = replace(card, semantic=moving, dynamic=moving >= 0)
    layer = concatenated_layers([wall, card])
    # What is labelled as still is where it was seen first, and the card is there at that time only.
    evidence = evidence_of(arrays, layer, VIEWS[:1], MOTION, 1)
    found = separated(layer, evidence, MOTION)
    beside = np.abs(np.array(STILL) * 2 / 3 + 0.5) > 0.4
    assert not found.dynamic[: len(STILL)][torch.from_numpy(beside)].any()
    assert found.dynamic[len(STILL) :].all()
    torch.testing.assert_close(found.dynamic, found.semantic >= 0)
    torch.testing.assert_close(found.gaussians.means, layer.gaussians.means)


def test_a_node_stays_where_it_was_shown_when_its_label_changes(arrays):
    """A still node on the card at the last time moves with it from now on, and is there at that time."""
    at_the_end = [x + WAY for x in MOVING]
    card, wall = static_layer(row_of_nodes(at_the_end, -1.0)), static_layer(row_of_nodes(STILL, 0.0))
    layer = concatenated_layers([card, wall])
    found = separated(layer, evidence_of(arrays, layer, VIEWS[-1:], MOTION, 1), MOTION)
    assert found.dynamic[: len(card)].all()
    shown = MOTION.shown(found.gaussians, found.semantic, 1.0)
    torch.testing.assert_close(shown.means, layer.gaussians.means, atol=1e-6, rtol=0)


def test_nodes_that_nobody_sees_keep_their_labels(arrays):
    behind = static_layer(row_of_nodes(MOVING, -9.0))
    behind = replace(
        behind, semantic=torch.zeros(3, dtype=torch.int32), dynamic=torch.ones(3, dtype=torch.bool)
    )
    found = separated(behind, evidence_of(arrays, behind, VIEWS, MOTION, 1), MOTION)
    assert found.dynamic.all()
    none = static_layer(Gaussians.none(0))
    assert len(separated(none, evidence_of(arrays, none, VIEWS, MOTION, 1), MOTION)) == 0


def test_what_something_has_left_behind_is_no_part_of_what_stands_still(arrays):
    """A still node on the way of the card: most views show it in front of the wall, one on the card."""
    smear, wall = static_layer(row_of_nodes(MOVING, -1.0)), static_layer(row_of_nodes(STILL, 0.0))
    layer = concatenated_layers([smear, wall])
    views = [view(0.0), *[view(1.0)] * 5]
    found = separated(layer, evidence_of(arrays, layer, views, MOTION, 1), MOTION)
    assert found.dynamic[: len(smear)].all()
    assert found.dynamic[len(smear) :].float().mean() < 0.2


def test_a_still_node_that_hovers_is_put_on_the_surface(arrays):
    """Nodes of 0.02 hover by 0.03 before the wall, of which they contribute to pixels; others stay."""
    nodes = row_of_nodes([0.3, 0.6, 0.9], -0.03)
    nodes.log_scales[:] = np.log(0.02)
    nodes.log_scales[:, 1] = np.log(0.04)
    layer = static_layer(nodes)
    evidence = evidence_of(arrays, layer, VIEWS[:1], MOTION, 1)
    found = separated(layer, evidence, MOTION).gaussians.means
    torch.testing.assert_close(found[2], torch.tensor([0.0, -0.03, 0.0]), atol=1e-5, rtol=0)
    torch.testing.assert_close(found[:2], nodes.means[:2], atol=1e-5, rtol=0)
