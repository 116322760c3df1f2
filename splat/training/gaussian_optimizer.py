"""Adam (Kingma and Ba 2015) on Gaussians: each step moves those that a view shows, and no others.

Of a scene with many rooms, a view shows few Gaussians. Moved by their momentum while nothing is known of
them, the others would drift; and most of a step would be spent on them.
"""

from __future__ import annotations

import math

import torch

from compose.base.files import under
from splat.model.gaussians import Directional, Gaussians, apart, as_rows
from splat.model.points import remoteness

# Decay of the moments, and what keeps their quotient finite.
_FIRST_DECAY, _SECOND_DECAY, _LEAST = 0.9, 0.999, 1e-15
_STATE = ("values", "first_moments", "second_moments", "steps")


class Adam:
    """Values (R, N), used up, and their moments; those of a column are means over its own steps."""

    def __init__(self, values: torch.Tensor):
        self.values = values
        # (R, N) of the gradients, and (N,) of each column.
        self.first_moments, self.second_moments = (torch.zeros_like(values) for _ in range(2))
        self.steps = values.new_zeros(values.shape[1])

    def step(self, index: torch.Tensor, gradient: torch.Tensor, rates: torch.Tensor) -> None:
        """Moves the columns at an index (M,), none twice, against a gradient (R, M) whose square is finite.

        Rates (R, M) or (R, 1) say how far a column goes in its first step.
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
        moved = self.values.index_select(1, index).addcdiv_(move, deviation, value=-1)
        self.values.scatter_(1, everywhere, moved)

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


# Learning rates at the start and at the end, exponential between them. With a tenth of the steps of 3D
# Gaussian splatting, positions, rotations and above all sizes need larger ones than there: half as large for
# sizes and a quarter for rotations, five scenes have 0.1 to 0.7 dB less after 200 steps, and 0.1 dB more at
# most after 1000. Positions are in units of a pixel at the views' median distance.
_MEANS, _SCALES, _ROTATIONS, _OPACITY = (0.15, 0.006), (0.1, 0.02), (0.016, 0.004), (0.05, 0.01)
_CONSTANT, _DIRECTIONAL = (0.016, 0.0024), (0.0016, 0.0004)
# Prefix, in checkpoints, of what belongs to harmonics above the constant one.
_DIRECTIONAL_STATE = "directional."
HOST = torch.device("cpu")


class GaussianOptimizer:
    """Optimizes Gaussians, which are copied; harmonics above the constant one only where they have them.

    The positions' learning rate is in units of `pixel`.
    """

    def __init__(self, gaussians: Gaussians, pixel: float, device: torch.device = HOST):
        self._pixel, self._device = pixel, device
        self._start(gaussians)

    def _start(self, gaussians: Gaussians) -> None:
        gaussians = apart(gaussians).to(self._device)
        assert gaussians.directional is not None
        # One row per number that a Gaussian has.
        self._all = Adam(torch.cat([as_rows(tensor.detach()) for _, tensor in gaussians.tensors()]))
        self._turning = Adam(as_rows(gaussians.directional.sh.detach()).clone())
        self._index = gaussians.directional.index
        self.chosen(torch.zeros(0, dtype=torch.int64, device=self._device))

    @property
    def on_device(self) -> Gaussians:
        """The Gaussians as they are now, without gradients, where steps are computed; shares memory."""
        return _gaussians(self._all.values, self._index, self._turning.values)

    @property
    def gaussians(self) -> Gaussians:
        """The same on the host."""
        return self.on_device.to(HOST)

    def chosen(self, index: torch.Tensor) -> Gaussians:
        """The Gaussians at an index (M,), copied; the next step moves these, by the gradients they get.

        Both are on the device.
        """
        slot = Directional(self._index, self._turning.values).slots(len(self._all.steps))[index]
        owners = torch.nonzero(slot >= 0)[:, 0]
        self._chosen, self._chosen_turning = index, slot[owners]
        columns = self._all.values.index_select(1, index)
        leaves = _gaussians(columns, owners, self._turning.values.index_select(1, self._chosen_turning))
        assert leaves.directional is not None
        own = (part.detach().requires_grad_() for _, part in leaves.tensors())
        further = Directional(owners, leaves.directional.sh.detach().requires_grad_())
        self._leaves = Gaussians(*own, directional=further)
        return self._leaves

    def step(self, loss: torch.Tensor, progress: float) -> bool:
        """Takes one step down the gradient of a loss, which is computed from what `chosen` returned.

        `progress`, the share of the training that is done, sets the learning rates. Returns whether it did:
        if the gradient is not finite, all stays as it is.
        """
        loss.backward()
        assert self._leaves.directional is not None
        gradient = torch.cat([_gradient(leaf) for _, leaf in self._leaves.tensors()])
        turning = _gradient(self._leaves.directional.sh)
        # The moments are made of squares. A sum of them takes a tenth of the time of a maximum; and each look
        # at a number waits for the device.
        flat = [part.reshape(-1) for part in (gradient, turning)]
        if not bool(torch.isfinite(loss.detach() + sum(torch.dot(part, part) for part in flat))):
            # Only the sum may be infinite. A maximum is NaN if any of its numbers is.
            extremes = [torch.linalg.vector_norm(part, torch.inf).square() for part in flat if len(part)]
            if not bool(torch.isfinite(torch.stack([loss.detach(), *extremes])).all()):
                return False
        # One of each row that all Gaussians have.
        means = tuple(self._pixel * rate for rate in _MEANS)
        rows = [means] * 3 + [_SCALES] * 3 + [_ROTATIONS] * 4 + [_OPACITY] + [_CONSTANT] * 3
        rates = self._between(rows, progress).repeat(1, len(self._chosen))
        # The unit is the size of a pixel at the median distance; far away a pixel is larger.
        # Lengths of vectors whose numbers lie side by side take a tenth of the time.
        rates[:3] *= remoteness(self._leaves.means.detach().T.contiguous().T)
        self._all.step(self._chosen, gradient, rates)
        self._turning.step(self._chosen_turning, turning, self._between([_DIRECTIONAL], progress))
        return True

    def _between(self, rows: list[tuple[float, ...]], progress: float) -> torch.Tensor:
        """(R, 1) learning rates between those at the start and at the end, on a logarithmic scale."""
        start, end = torch.tensor(rows).log().T
        return torch.lerp(start, end, progress).exp()[:, None].to(self._device)

    def limit_scales(self, largest: torch.Tensor) -> None:
        """Makes scales smaller whose logarithms exceed (N,) largest ones."""
        scales = self.on_device.log_scales
        torch.minimum(scales, largest.to(self._device), out=scales)

    def replace(self, gaussians: Gaussians, kept: torch.Tensor) -> None:
        """Continues with other Gaussians, the first M of which keep the moments they had at indices (M,)."""
        before, turning, kept = self._all, self._turning, kept.to(self._device)
        former = Directional(self._index, turning.values).slots(len(before.steps))[kept]
        self._start(gaussians)
        self._all.remember(before, torch.arange(len(kept), device=self._device), kept)
        first = int(torch.searchsorted(self._index, len(kept)))
        known = torch.nonzero(former[self._index[:first]] >= 0)[:, 0]
        self._turning.remember(turning, known, former[self._index[known]])

    def state(self) -> dict[str, torch.Tensor]:
        """Tensors for a checkpoint, on the host: parameters and moments; they share memory that is there."""
        turning = {**self._turning.state(), "index": self._index}
        named = {**self._all.state(), **{_DIRECTIONAL_STATE + name: t for name, t in turning.items()}}
        return {name: tensor.to(HOST) for name, tensor in named.items()}

    @classmethod
    def restored(
        cls, tensors: dict[str, torch.Tensor], pixel: float, device: torch.device = HOST
    ) -> GaussianOptimizer:
        """The optimizer whose `state` these tensors are; other tensors are ignored."""
        turning = under(_DIRECTIONAL_STATE, tensors)
        optimizer = cls(_gaussians(tensors["values"], turning["index"], turning["values"]), pixel, device)
        optimizer._all.restore(tensors)
        optimizer._turning.restore(turning)
        return optimizer


def _gaussians(rows: torch.Tensor, index: torch.Tensor, turning: torch.Tensor) -> Gaussians:
    """Gaussians of their rows, and of those of the harmonics that some have; shares memory."""
    further = Directional(index, turning.reshape(len(turning) // 3, 3, len(index)))
    return Gaussians(rows[:3], rows[3:6], rows[6:10], rows[10], rows[11:][None], directional=further)


def _gradient(leaf: torch.Tensor) -> torch.Tensor:
    return as_rows(torch.zeros_like(leaf) if leaf.grad is None else leaf.grad)
