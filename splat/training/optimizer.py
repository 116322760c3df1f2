"""Adam on the parameters of Gaussians whose number changes during training."""

from __future__ import annotations

import math

import torch

from splat.model.gaussians import Gaussians
from splat.model.remoteness import remoteness

# Learning rates at the start and at the end, exponential between them. Those of 3D Gaussian splatting are
# for 30,000 steps; with a tenth of the steps the positions need larger ones. Positions are in units of
# the size of a pixel at the views' median distance.
_RATES = {
    "means": (0.15, 0.006),
    "log_scales": (0.01, 0.002),
    "rotations": (0.004, 0.001),
    "opacity_logits": (0.05, 0.01),
    "sh_constant": (0.008, 0.0012),
    "sh_directional": (0.0008, 0.0002),
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
        tensors = {name: getattr(gaussians, name) for name in _GEOMETRY}
        tensors |= {"sh_constant": gaussians.sh[:1], "sh_directional": gaussians.sh[1:]}
        self._leaves = {n: t.clone().contiguous().requires_grad_() for n, t in tensors.items()}
        groups = [{"params": [leaf], "name": name} for name, leaf in self._leaves.items()]
        self._adam = torch.optim.Adam(groups, lr=0.0, betas=(0.9, 0.999), eps=1e-15, fused=True)

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as they are now; gradients flow to the optimized tensors."""
        return _gaussians(self._leaves)

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
        self._adam.zero_grad()
        loss.backward()
        if not self._is_finite():
            return False
        # The unit is the size of a pixel at the median distance. Far away a pixel is larger, and a step of
        # this length would be lost in rounding.
        means = self._leaves["means"].detach()
        larger = remoteness(means)
        means /= larger
        self._adam.step()
        means *= larger
        return True

    def _is_finite(self) -> bool:
        """Whether all gradients are finite, and their squares, of which the moments are made."""
        found = [leaf.grad for leaf in self._leaves.values() if leaf.grad is not None and leaf.numel()]
        # A maximum is NaN if any of its numbers is.
        largest = [torch.linalg.vector_norm(gradient, torch.inf) for gradient in found]
        return not largest or bool(torch.isfinite(torch.stack(largest).square()).all())

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
        for name, leaf in optimizer._leaves.items():
            if f"adam.step.{name}" in tensors:
                moments = {moment: tensors[f"adam.{moment}.{name}"] for moment in _MOMENTS}
                optimizer._adam.state[leaf] = moments
        return optimizer


def _gaussians(leaves: dict[str, torch.Tensor]) -> Gaussians:
    sh = torch.cat([leaves["sh_constant"], leaves["sh_directional"]])
    return Gaussians(**{name: leaves[name] for name in _GEOMETRY}, sh=sh)
