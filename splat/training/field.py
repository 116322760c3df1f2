"""Adam on the parameters of a field, beside that of the Gaussians."""

from __future__ import annotations

from typing import Any

import torch

from compose.base.named import under
from splat.deformation.learned import LearnedMotion

# Share of the steps before the field is trained: the Gaussians become the mean of what is seen first.
_WARM_UP = 0.1
_LEAST = 1e-15
# Prefixes of tensors in checkpoints.
_VALUES, _MOMENTS = "values.", "moments."


class FieldOptimizer:
    """Optimizes the field of a learned motion.

    Args:
        motion: learned; its field is changed in place.
        steps: of the training.
    """

    def __init__(self, motion: LearnedMotion, steps: int):
        self._motion, self._steps, self._rates = motion, steps, list(motion.field.RATES.values())
        groups: list[dict[str, Any]] = [{"params": []} for _ in self._rates]
        for name, parameter in motion.field.named_parameters():
            # The last one, without a name, takes all that no other one has.
            group = next(i for i, prefix in enumerate(motion.field.RATES) if name.startswith(prefix))
            groups[group]["params"].append(parameter)
        self._parameters = list(motion.field.parameters())
        self._adam = torch.optim.Adam(groups, lr=1.0, eps=_LEAST)

    def step(self, done: int, valid: bool) -> None:
        """Takes one step by the gradients that the parameters have, and clears them.

        Args:
            done: steps of the training so far.
            valid: whether the gradients are those of a finite loss.
        """
        progress = done / self._steps
        gradients = [parameter.grad for parameter in self._parameters if parameter.grad is not None]
        finite = all(bool(torch.isfinite(gradient).all()) for gradient in gradients)
        if valid and finite and gradients and progress >= _WARM_UP:
            for group, (start, end) in zip(self._adam.param_groups, self._rates, strict=True):
                group["lr"] = start * (end / start) ** progress
            self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def state(self) -> dict[str, torch.Tensor]:
        """Tensors for a checkpoint: the motion, and moments and steps of all parameters."""
        found = {_VALUES + name: tensor for name, tensor in self._motion.tensors().items()}
        for number, parameter in enumerate(self._parameters):
            for name, tensor in self._adam.state.get(parameter, {}).items():
                found[f"{_MOMENTS}{number}.{name}"] = tensor
        return found

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Restores what `state` returned."""
        self._motion.restore(under(_VALUES, tensors))
        for name, tensor in under(_MOMENTS, tensors).items():
            number, key = name.split(".", 1)
            self._adam.state[self._parameters[int(number)]][key] = tensor
