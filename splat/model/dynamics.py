"""What every motion of a forest can do, known or learned."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch

from splat.model.gaussians import Gaussians


class Dynamics(Protocol):
    """Where nodes that belong to instances are at a time."""

    def shown(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        """Gaussians as they are at a time; torch can differentiate them by those at rest.

        Args:
            gaussians: N Gaussians at rest.
            instance: (N,) that each belongs to; below 0, it stays where it is.
            time: from 0 to 1.
        """

    def course(self, gaussians: Gaussians, instance: torch.Tensor) -> Callable[[float], Gaussians]:
        """`shown` of some Gaussians as a function of time: what all times share is found once."""

    def at_rest(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        """The way back: at rest, Gaussians that are shown at a time; arguments as of `shown`."""

    def tensors(self) -> dict[str, torch.Tensor]:
        """All numbers, by name."""

    def __len__(self) -> int:
        """Number of instances."""
