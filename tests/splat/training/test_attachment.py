"""Nodes are on a surface, or hover before it, or are behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from splat.training.moving_nodes import Attachment
from splat.training.training_view import TrainingView
from tests.splat.training.test_nodes import CAMERA, SIZE, row_of_nodes, view

CARD = view(0.0)


def attached(xs: list[float], z: float, seen: TrainingView = CARD) -> Attachment:
    return Attachment(row_of_nodes(xs, z), seen, seen.instance)


def test_a_node_at_an_edge_in_the_view_is_on_the_surface_in_front_only():
    """The card, at z = -1, ends at x = -0.25; around it the wall, at z = 0, is seen."""
    labels = np.array([-1, 0], dtype=np.int32)
    assert attached([-0.27, -0.5], -1.0).on(labels).tolist() == [[False, True], [False, True]]
    assert attached([-0.38], 0.0).on(labels).tolist() == [[True, False]]
    assert not attached([-0.27], -0.5).on(labels).any()
    assert not attached([0.5], -1.0).on(labels).any()


def test_nodes_beside_or_behind_a_view_are_on_nothing():
    labels = np.array([-1, 0], dtype=np.int32)
    assert not attached([9.0, 0.0], -6.0).on(labels).any()
    assert not attached([5.0], 0.0).on(labels).any()


def test_the_way_to_a_surface_is_the_one_along_its_normal():
    """Nodes are 0.08 large; the wall faces the camera."""
    ways, near = attached([0.5, 0.9, 0.3], -0.06).ways(-1)
    assert near.all()
    np.testing.assert_allclose(ways, np.tile([0, 0, 0.06], (3, 1)), atol=1e-6)
    ways, near = attached([0.5], -0.4).ways(-1)
    assert not near.any()
    assert not ways.any()
    ways, near = attached([-0.5], -1.0).ways(-1)
    assert not near.any()


def test_guesses_and_unknown_normals_lead_nowhere():
    for seen in (replace(CARD, guessed=True), replace(CARD, normal=np.zeros((SIZE, SIZE, 3), np.float32))):
        assert not attached([0.5], -0.06, seen).ways(-1)[1].any()


def test_a_floor_that_is_seen_at_a_flat_angle_has_its_nodes_on_it():
    """Distances change by more from pixel to pixel than nodes are large; what hovers is off all the same."""
    rays = CAMERA.rays(CAMERA.pixel_centres())
    down = rays[:, 1] > 0.06
    # A floor 0.5 below the camera, whose y axis points down.
    distance = np.where(down, 0.5 / np.where(down, rays[:, 1], 1), np.inf).reshape(SIZE, SIZE)
    labels = np.full((SIZE, SIZE), -1, dtype=np.int32)
    seen = replace(CARD, distance=distance.astype(np.float32), instance=labels)
    depths = np.linspace(1.6, 2.6, 15)
    found = []
    for height in (0.0, 0.2):
        nodes = row_of_nodes([0.05] * len(depths), 0.0)
        nodes.means[1], nodes.means[2] = 0.5 - height, torch.from_numpy(depths - 3)
        nodes.log_scales[:] = -6.0
        found.append(Attachment(nodes, seen, labels).on(np.array([-1], dtype=np.int32))[:, 0])
    assert found[0].all()
    assert not found[1].any()
