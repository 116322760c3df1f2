"""What is far away counts by how it looks."""

from __future__ import annotations

import torch

from splat.model.gaussians import Gaussians
from splat.model.points import remoteness
from splat.model.trees import build_forest, static_layer


def test_only_what_is_far_away_is_remote():
    means = torch.tensor([[0.0, 100.0, 400.0, 1e5], [0, 0, 0, 0], [0, 50, 300, 0]])
    assert remoteness(means).tolist() == [1, 1, 125, 25000]


def test_the_sky_gets_trees_as_what_is_near_does():
    """The same Gaussians, 25,000 times as far away and as large: as few of them in the coarse layers."""
    rng = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(3, 200, generator=rng), dim=0)
    counts = []
    for distance in (4.0, 1e5):
        scales = torch.full((3, 200), 0.01 * distance).log()
        turns = torch.tensor([[1.0], [0], [0], [0]]).repeat(1, 200)
        sky = Gaussians(distance * directions, scales, turns, torch.zeros(200), torch.zeros(1, 3, 200))
        counts.append([len(layer) for layer in build_forest(static_layer(sky), 0.02, 3)])
    assert counts[0] == counts[1]
    assert counts[0][0] < 100
