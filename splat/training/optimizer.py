"""Adam on the parameters of Gaussians: each step moves those that a view shows, and no others.

Of a scene with many rooms, a view shows few Gaussians. Moved by their momentum while nothing is known of
them, the others would drift; and most of a step would be spent on them.
"""

from __future__ import annotations

import math

import torch

from splat.model.gaussians import Gaussians
from splat.model.remoteness import remoteness

# Learning rates at the start and at the end, exponential between them. Those of 3D Gaussian splatting are
# for 30,000 steps; with a tenth of the steps the positions need larger ones, and the sizes above all: seeds
# are as wide as the gaps between them, whatever the detail there. Positions are in units of the size of a
# pixel at the views' median distance.
_MEANS, _SCALES, _ROTATIONS, _OPACITY = (0.15, 0.006), (0.05, 0.01), (0.004, 0.001), (0.05, 0.01)
_CONSTANT, _DIRECTIONAL = (0.016, 0.0024), (0.0016, 0.0004)
# Decay of the moments, and what keeps their quotient finite (Kingma and Ba 2015).
_FIRST_DECAY, _SECOND_DECAY, _LEAST = 0.9, 0.999, 1e-15
_STATE = ("values", "first_moments", "second_moments", "steps")


class GaussianOptimizer:
    """Optimizes Gaussians; the constant spherical harmonic has a learning rate of its own.

    Args:
        gaussians: where to start; copied.
        pixel: unit of the positions' learning rate.
    """

    def __init__(self, gaussians: Gaussians, pixel: float):
        self._pixel = pixel
        self._start(gaussians)

    def _start(self, gaussians: Gaussians) -> None:
        # One row per number that a Gaussian has.
        self._values = _rows(gaussians)
        self._first_moments, self._second_moments = (torch.zeros_like(self._values) for _ in range(2))
        self._steps = torch.zeros(len(gaussians))
        self.chosen(torch.zeros(0, dtype=torch.int64))

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as they are now, without gradients; shares memory."""
        return _gaussians(self._values)

    def chosen(self, index: torch.Tensor) -> Gaussians:
        """The Gaussians at an index (M,), copied; the next step moves these, by the gradients they get."""
        self._chosen, self._chosen_values = index, self._values.index_select(1, index)
        leaves = _gaussians(self._chosen_values)
        self._leaves = Gaussians(**{name: part.detach().requires_grad_() for name, part in leaves.tensors()})
        return self._leaves

    def step(self, loss: torch.Tensor, progress: float) -> bool:
        """Takes one step down the gradient of a loss, unless that is not finite.

        Args:
            loss: computed from what `chosen` returned.
            progress: share of the training that is done, 0..1, which sets the learning rates.

        Returns:
            Whether it did: otherwise, parameters and moments are as before.
        """
        if not bool(torch.isfinite(loss)):
            return False
        loss.backward()
        gradient = torch.cat([_gradient(leaf) for _, leaf in self._leaves.tensors()])
        if not _has_finite_squares(gradient):
            return False
        index = self._chosen
        steps = self._steps.index_select(0, index).add_(1)
        first = self._first_moments.index_select(1, index).lerp_(gradient, 1 - _FIRST_DECAY)
        second = self._second_moments.index_select(1, index).mul_(_SECOND_DECAY)
        second.addcmul_(gradient, gradient, value=1 - _SECOND_DECAY)
        self._steps.index_copy_(0, index, steps)
        self._first_moments.index_copy_(1, index, first)
        self._second_moments.index_copy_(1, index, second)
        # Each Gaussian's moments are means over its own steps.
        deviation = second.div_(_share_seen(_SECOND_DECAY, steps)).sqrt_().add_(_LEAST)
        move = first.div_(_share_seen(_FIRST_DECAY, steps)).div_(deviation).mul_(self._rates(progress))
        # The unit is the size of a pixel at the median distance; far away a pixel is larger.
        move[:3] *= remoteness(self._leaves.means.detach())
        self._values.index_copy_(1, index, self._chosen_values - move)
        return True

    def _rates(self, progress: float) -> torch.Tensor:
        """(R, 1) learning rate of each row."""
        means = tuple(self._pixel * rate for rate in _MEANS)
        ends = [means] * 3 + [_SCALES] * 3 + [_ROTATIONS] * 4 + [_OPACITY] + [_CONSTANT] * 3
        ends += [_DIRECTIONAL] * (len(self._values) - len(ends))
        start, end = torch.tensor(ends).log().T
        return torch.lerp(start, end, progress).exp()[:, None]

    def limit_scales(self, largest: torch.Tensor) -> None:
        """Makes scales smaller whose logarithms exceed (N,) largest ones."""
        scales = self.gaussians.log_scales
        torch.minimum(scales, largest, out=scales)

    def replace(self, gaussians: Gaussians, kept: torch.Tensor) -> None:
        """Continues with other Gaussians.

        Args:
            gaussians: M or more, the first M of which were optimized before and keep their moments.
            kept: (M,) the indices they had.
        """
        before = self.state()
        self._start(gaussians)
        for name in _STATE[1:]:
            self.state()[name][..., : len(kept)] = before[name][..., kept]

    def state(self) -> dict[str, torch.Tensor]:
        """Tensors for a checkpoint: parameters and moments; they share memory."""
        return {name: getattr(self, f"_{name}") for name in _STATE}

    @classmethod
    def restored(cls, tensors: dict[str, torch.Tensor], pixel: float) -> GaussianOptimizer:
        """The optimizer whose `state` these tensors are; other tensors are ignored."""
        optimizer = cls(_gaussians(tensors["values"]), pixel)
        for name in _STATE[1:]:
            optimizer.state()[name][:] = tensors[name]
        return optimizer


def _rows(gaussians: Gaussians) -> torch.Tensor:
    """(R, N) all numbers of N Gaussians, copied."""
    return torch.cat([_flat(tensor.detach()) for _, tensor in gaussians.tensors()])


def _gaussians(rows: torch.Tensor) -> Gaussians:
    """The Gaussians whose `_rows` these are; shares memory."""
    return Gaussians(rows[:3], rows[3:6], rows[6:10], rows[10], rows[11:].unflatten(0, (-1, 3)))


def _gradient(leaf: torch.Tensor) -> torch.Tensor:
    """(rows, M) derivative by a tensor (..., M); 0 where nothing depends on it."""
    return _flat(torch.zeros_like(leaf) if leaf.grad is None else leaf.grad)


def _flat(tensor: torch.Tensor) -> torch.Tensor:
    """(rows, N) of (..., N)."""
    return tensor.reshape(math.prod(tensor.shape[:-1]), tensor.shape[-1])


def _share_seen(decay: float, steps: torch.Tensor) -> torch.Tensor:
    """1 - decay^steps: the weight in a moment of the gradients so far."""
    return torch.expm1(steps * math.log(decay)).neg_()


def _has_finite_squares(gradient: torch.Tensor) -> bool:
    """Whether a gradient is finite, and its square, of which the moments are made."""
    flat = gradient.reshape(-1)
    # Where a sum of squares is finite, each of them is; it takes a tenth of the time of a maximum.
    if bool(torch.isfinite(torch.dot(flat, flat))):
        return True
    # A maximum is NaN if any of its numbers is.
    return bool(torch.isfinite(torch.linalg.vector_norm(flat, torch.inf).square()))
