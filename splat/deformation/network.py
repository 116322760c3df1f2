"""The deformation network of D-GS (Yang et al. 2024, Deformable 3D Gaussians)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from splat.deformation.field import Deformation, Heads

# Frequencies of the positional encoding: of places, and of times as for synthetic scenes.
_PLACES, _TIMES = 10, 6
_WIDTH, _DEPTH = 256, 8
# The encoding is joined to the features again after the layer of this index.
_JOINED = 4


class DeformationNetwork(torch.nn.Module):
    """A perceptron of eight layers that sees a place and a time."""

    # Learning rates at the start and at the end.
    RATES: ClassVar = {"": (8e-4, 1.6e-6)}

    def __init__(self) -> None:
        super().__init__()
        width = 3 * (1 + 2 * _PLACES) + 1 + 2 * _TIMES
        inputs = [width] + [_WIDTH + (width if index - 1 == _JOINED else 0) for index in range(1, _DEPTH)]
        self.layers = torch.nn.ModuleList(torch.nn.Linear(size, _WIDTH) for size in inputs)
        self.heads = Heads(_WIDTH, hidden=False)

    def forward(self, means: Tensor, time: float) -> Deformation:
        """How Gaussians with means (3, N) are deformed at a time from 0 to 1."""
        times = means.new_full((means.shape[1], 1), time)
        encoded = torch.cat([_encoded(means.T, _PLACES), _encoded(times, _TIMES)], dim=1)
        features = encoded
        for index, layer in enumerate(self.layers):
            features = torch.relu(layer(features))
            if index == _JOINED:
                features = torch.cat([encoded, features], dim=1)
        return self.heads(features)


def _encoded(values: Tensor, frequencies: int) -> Tensor:
    """(N, C (1 + 2 F)) values (N, C), and sines and cosines of their multiples by 1, 2, 4, ..."""
    waves = [values]
    for power in range(frequencies):
        waves += [torch.sin(values * 2.0**power), torch.cos(values * 2.0**power)]
    return torch.cat(waves, dim=1)
