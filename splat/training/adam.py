"""Adam (Kingma and Ba 2015) on the columns of a table, of which each step moves some."""

from __future__ import annotations

import math

import torch

# Decay of the moments, and what keeps their quotient finite.
_FIRST_DECAY, _SECOND_DECAY, _LEAST = 0.9, 0.999, 1e-15
_STATE = ("values", "first_moments", "second_moments", "steps")


class Adam:
    """Values and their moments; the moments of a column are means over its own steps.

    Args:
        values: (R, N) where to start; used up.

    Attributes:
        values: as they are now.
        first_moments, second_moments: (R, N) of their gradients.
        steps: (N,) of each column.
    """

    def __init__(self, values: torch.Tensor):
        self.values = values
        self.first_moments, self.second_moments = (torch.zeros_like(values) for _ in range(2))
        self.steps = values.new_zeros(values.shape[1])

    def step(self, index: torch.Tensor, gradient: torch.Tensor, rates: torch.Tensor) -> None:
        """Moves the columns at an index (M,) against a gradient (R, M).

        Args:
            index: no column twice.
            gradient: finite, and its square, too.
            rates: (R, M) or (R, 1), how far a column goes in its first step.
        """
        steps = self.steps.index_select(0, index).add_(1)
        first = self.first_moments.index_select(1, index).lerp_(gradient, 1 - _FIRST_DECAY)
        second = self.second_moments.index_select(1, index).mul_(_SECOND_DECAY)
        second.addcmul_(gradient, gradient, value=1 - _SECOND_DECAY)
        self.steps.index_copy_(0, index, steps)
        # Writes what index_copy_ does, in a third of the time.
        everywhere = index.expand_as(gradient)
        self.first_moments.scatter_(1, everywhere, first)
        self.second_moments.scatter_(1, everywhere, second)
        deviation = second.sqrt_().mul_(_share_seen(_SECOND_DECAY, steps).rsqrt_()).add_(_LEAST)
        move = first.mul_(rates / _share_seen(_FIRST_DECAY, steps))
        self.values.scatter_(
            1, everywhere, self.values.index_select(1, index).addcdiv_(move, deviation, value=-1)
        )

    def remember(self, former: Adam, now: torch.Tensor, before: torch.Tensor) -> None:
        """Columns at an index (M,) go on with the moments of those that were at another one (M,)."""
        for name in _STATE[1:]:
            getattr(self, name)[..., now] = getattr(former, name)[..., before]

    def state(self) -> dict[str, torch.Tensor]:
        """Tensors for a checkpoint; they share memory."""
        return {name: getattr(self, name) for name in _STATE}

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Restores the moments that `state` returned."""
        for name in _STATE[1:]:
            getattr(self, name)[:] = tensors[name]


def _share_seen(decay: float, steps: torch.Tensor) -> torch.Tensor:
    """1 - decay^steps: the weight in a moment of the gradients so far."""
    return torch.expm1(steps * math.log(decay)).neg_()
