"""Adam on the parameters of Gaussians whose number changes during training."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch

from splat.model.gaussians import Gaussians
from splat.model.remoteness import remoteness

# Learning rates at the start and at the end, exponential between them. Those of 3D Gaussian splatting are
# for 30,000 steps; with a tenth of the steps the positions need larger ones, and the sizes above all: seeds
# are as wide as the gaps between them, whatever the detail there. Positions are in units of the size of a
# pixel at the views' median distance.
_RATES = {
    "means": (0.15, 0.006),
    "log_scales": (0.05, 0.01),
    "rotations": (0.004, 0.001),
    "opacity_logits": (0.05, 0.01),
    "sh_constant": (0.016, 0.0024),
    "sh_directional": (0.0016, 0.0004),
}
_GEOMETRY = ("means", "log_scales", "rotations", "opacity_logits")
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


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
        self._leaves = {n: t.clone().contiguous().requires_grad_() for n, t in gaussians.tensors()}
        groups = [{"params": [part], "name": name} for name, part in self._parts(torch.Tensor.detach).items()]
        self._adam = torch.optim.Adam(groups, lr=0.0, betas=(0.9, 0.999), eps=1e-15, fused=True)

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as they are now; gradients flow to the optimized tensors."""
        return Gaussians(**self._leaves)

    def _parts(self, of: Callable[[torch.Tensor], torch.Tensor]) -> dict[str, torch.Tensor]:
        """By the name of its learning rate, each part of what `of` gives for the leaves, in their memory."""
        parts = {name: of(self._leaves[name]) for name in _GEOMETRY}
        sh = of(self._leaves["sh"])
        return parts | {"sh_constant": sh[:1], "sh_directional": sh[1:]}

    def step(self, loss: torch.Tensor, progress: float) -> bool:
        """Takes one step down the gradient of a loss, unless that is not finite.

        Args:
            loss: computed from `gaussians`.
            progress: share of the training that is done, 0..1, which sets the learning rates.

        Returns:
            Whether it did: otherwise, parameters and moments are as before.
        """
        if not bool(torch.isfinite(loss)):
            return False
        for group in self._adam.param_groups:
            start, end = _RATES[group["name"]]
            unit = self._pixel if group["name"] == "means" else 1.0
            group["lr"] = unit * math.exp((1 - progress) * math.log(start) + progress * math.log(end))
        for leaf in self._leaves.values():
            leaf.grad = None
        loss.backward()
        if not self._is_finite():
            return False
        for group, part in zip(self._adam.param_groups, self._parts(_gradient).values(), strict=True):
            group["params"][0].grad = part
        # The unit is the size of a pixel at the median distance. Far away a pixel is larger, and a step of
        # this length would be lost in rounding.
        means = self._leaves["means"].detach()
        larger = remoteness(means)
        means /= larger
        self._adam.step()
        means *= larger
        return True

    def limit_scales(self, largest: torch.Tensor) -> None:
        """Makes scales smaller whose logarithms exceed (N,) largest ones."""
        scales = self._leaves["log_scales"].detach()
        torch.minimum(scales, largest, out=scales)

    def _is_finite(self) -> bool:
        """Whether all gradients are finite, and their squares, of which the moments are made."""
        found = [_gradient(leaf).reshape(-1) for leaf in self._leaves.values() if leaf.numel()]
        # Where a sum of squares is finite, each of them is; it takes a tenth of the time of a maximum.
        if all(bool(torch.isfinite(torch.dot(gradient, gradient))) for gradient in found):
            return True
        # A maximum is NaN if any of its numbers is.
        largest = [torch.linalg.vector_norm(gradient, torch.inf) for gradient in found]
        return bool(torch.isfinite(torch.stack(largest).square()).all())

    def replace(self, gaussians: Gaussians, kept: torch.Tensor) -> None:
        """Continues with other Gaussians.

        Args:
            gaussians: M or more, the first M of which were optimized before and keep their moments.
            kept: (M,) the indices they had.
        """
        before = self._adam
        self._start(gaussians)
        for old, new in zip(before.param_groups, self._adam.param_groups, strict=True):
            state = before.state.get(old["params"][0])
            if state:
                leaf = new["params"][0]
                grown = {"step": state["step"].clone()}
                for moment in ("exp_avg", "exp_avg_sq"):
                    grown[moment] = torch.zeros_like(leaf)
                    grown[moment][..., : len(kept)] = state[moment][..., kept]
                self._adam.state[leaf] = grown

    def state(self) -> dict[str, torch.Tensor]:
        """Tensors for a checkpoint: parameters and moments."""
        tensors = {}
        for group in self._adam.param_groups:
            name, leaf = group["name"], group["params"][0]
            tensors[f"leaf.{name}"] = leaf.detach()
            for moment, value in self._adam.state.get(leaf, {}).items():
                tensors[f"adam.{moment}.{name}"] = value
        return tensors

    @classmethod
    def restored(cls, tensors: dict[str, torch.Tensor], pixel: float) -> GaussianOptimizer:
        """The optimizer whose `state` these tensors are; other tensors are ignored."""
        optimizer = cls(_gaussians({name: tensors[f"leaf.{name}"] for name in _RATES}), pixel)
        for group in optimizer._adam.param_groups:
            name = group["name"]
            if f"adam.step.{name}" in tensors:
                moments = {moment: tensors[f"adam.{moment}.{name}"] for moment in _MOMENTS}
                optimizer._adam.state[group["params"][0]] = moments
        return optimizer


def _gradient(leaf: torch.Tensor) -> torch.Tensor:
    return torch.zeros_like(leaf) if leaf.grad is None else leaf.grad


def _gaussians(parts: dict[str, torch.Tensor]) -> Gaussians:
    sh = torch.cat([parts["sh_constant"], parts["sh_directional"]])
    return Gaussians(**{name: parts[name] for name in _GEOMETRY}, sh=sh)
