"""Gaussians stay small beside their distance from viewers."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splat.training.density import largest_log_scales
from splat.training.initialization import seed_at
from splat.training.layer_training import LayerTraining
from tests.splat.training.frames import WALLS


def test_the_nearest_view_decides():
    eyes = np.stack([view.camera.position for view in WALLS])
    means = np.array([eyes[0] + [0, 0, 2.0], eyes[-1] + [0, 0.5, 0], eyes[0]])
    distance = np.linalg.norm(means[:, None] - eyes[None], axis=2).min(axis=1)
    largest = largest_log_scales(torch.from_numpy(means.T).float(), WALLS)
    assert largest[:2].exp().numpy() == pytest.approx(0.12 * distance[:2], rel=1e-5)
    # At a viewer's eye there is still a size.
    assert float(largest[2].exp()) == pytest.approx(0.0012, rel=1e-5)


def test_training_keeps_them_small(arrays):
    """One of two hundred seeds is as large as the wall."""
    seeds = seed_at(WALLS[0], np.arange(0, 1000, 5), 0.6, degree=1)
    seeds.gaussians.log_scales[:, 7] = 2.0
    training = LayerTraining(arrays, WALLS, 60, [0, 0])
    training.begin(seeds, len(seeds))
    for _ in range(30):
        training.step(grows=False)
    found = training.layer.gaussians
    # A few steps later they may be a little larger again.
    assert (found.log_scales <= largest_log_scales(found.means, WALLS) + 0.3).all()
