"""Fields: how far anything in space is deformed at any time, as modules that are trained."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from splat.model.gaussians import Gaussians


@dataclass(frozen=True)
class Deformation:
    """How N Gaussians differ from those at rest.

    Attributes:
        shifts: (3, N) of their means.
        turns: (4, N) that are added to their unit quaternions.
        growths: (3, N) that are added to their log scales.
    """

    shifts: Tensor
    turns: Tensor
    growths: Tensor

    def applied(self, gaussians: Gaussians) -> Gaussians:
        """The Gaussians, deformed.

        D-GS adds growths after the exponential, where they can make scales negative; here they are added
        before it.
        """
        unit = gaussians.rotations / gaussians.rotations.norm(dim=0, keepdim=True)
        return replace(
            gaussians,
            means=gaussians.means + self.shifts,
            rotations=unit + self.turns,
            log_scales=gaussians.log_scales + self.growths,
        )


class Heads(torch.nn.Module):
    """Turns features of points into their deformation; there is none at first.

    Args:
        width: number of features.
        hidden: whether each head has a hidden layer of as many features.
    """

    def __init__(self, width: int, hidden: bool):
        super().__init__()
        for name, size in (("shifts", 3), ("turns", 4), ("growths", 3)):
            last = torch.nn.Linear(width, size)
            torch.nn.init.zeros_(last.weight)
            torch.nn.init.zeros_(last.bias)
            before = [torch.nn.Linear(width, width), torch.nn.ReLU()] if hidden else []
            self.add_module(name, torch.nn.Sequential(*before, last))

    def forward(self, features: Tensor) -> Deformation:
        """The deformation of N points from their features (N, width)."""
        return Deformation(*(getattr(self, name)(features).T for name in ("shifts", "turns", "growths")))
