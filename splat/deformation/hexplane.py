"""The deformation field of 4DGS (Wu et al. 2024, 4D Gaussian Splatting): six planes of features."""

from __future__ import annotations

from itertools import combinations
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from splat.deformation.field import Deformation, Heads

# Features of a plane, and cells along an axis of space at each resolution, and along time.
_FEATURES, _SPACE, _TIME = 32, (64, 128), 25
_WIDTH = 64
# Pairs of the axes x, y, z, t.
_PAIRS = tuple(combinations(range(4), 2))


class HexPlane(torch.nn.Module):
    """Planes over each pair of the axes x, y, z and time, and a small perceptron.

    Its regularizers (total variation of planes) are left out.

    Args:
        low, high: (3,) corners of the box within which places differ.
    """

    # Learning rates at the start and at the end: those of 4DGS are for 20,000 steps, a few times as many as
    # are taken here, and are as many times smaller.
    RATES: ClassVar = {"planes": (6.4e-3, 6.4e-4), "": (6.4e-4, 6.4e-5)}
    low: Tensor
    high: Tensor

    def __init__(self, low: Tensor, high: Tensor):
        super().__init__()
        self.register_buffer("low", low.float())
        self.register_buffer("high", high.float())
        self.planes = torch.nn.ParameterList(
            _plane(a, b, (space, space, space, _TIME)) for space in _SPACE for a, b in _PAIRS
        )
        self.mix = torch.nn.Linear(_FEATURES * len(_SPACE), _WIDTH)
        self.heads = Heads(_WIDTH, hidden=True)

    def forward(self, means: Tensor, time: float) -> Deformation:
        """How Gaussians with means (3, N) are deformed at a time from 0 to 1."""
        size = (self.high - self.low).clamp(min=1e-6)
        places = 2 * (means.T - self.low) / size - 1
        at = torch.cat([places, means.new_full((means.shape[1], 1), 2 * time - 1)], dim=1)  # (N, 4)
        levels = []
        for level in range(len(_SPACE)):
            product = means.new_ones(means.shape[1], _FEATURES)
            for number, (a, b) in enumerate(_PAIRS):
                plane = self.planes[level * len(_PAIRS) + number]
                product = product * _sampled(plane, at[:, a], at[:, b])
            levels.append(product)
        return self.heads(torch.relu(self.mix(torch.cat(levels, dim=1))))


def _plane(a: int, b: int, cells: tuple[int, ...]) -> torch.nn.Parameter:
    """(1, F, cells of b, cells of a) features: those over time are 1 at first, as if nothing moved."""
    shape = 1, _FEATURES, cells[b], cells[a]
    if b == 3:
        return torch.nn.Parameter(torch.ones(shape))
    return torch.nn.Parameter(torch.rand(shape) * 0.4 + 0.1)


def _sampled(plane: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """(N, F) features of a plane at coordinates a and b (N,), -1 to 1, linear between cells."""
    grid = torch.stack([a, b], dim=1)[None, None]  # (1, 1, N, 2)
    found = functional.grid_sample(plane, grid, align_corners=True, padding_mode="border")
    return found[0, :, 0].T
