"""Fits Gaussians to frames: views in turn, Adam, density control, checkpoints."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch

from splat.arrays import Arrays
from splat.density import DensityControl
from splat.gaussians import Gaussians, concatenated
from splat.loss import Target
from splat.project import PIXEL_FILTER
from splat.render import render_differentiable
from splat.seed import TrainingView, seed_from_views


@dataclass(frozen=True)
class TrainingSettings:
    """How Gaussians are trained.

    Attributes:
        iterations: optimizer steps; one frame each.
        gaussians: how many there are in the end.
        degree: of the spherical harmonics.
        seed: same seed, same Gaussians.

    Raises:
        ValueError: a number is out of range.
    """

    iterations: int = 3000
    gaussians: int = 60_000
    degree: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        if self.iterations <= 0 or self.gaussians <= 0:
            raise ValueError("iterations and gaussians must be positive")
        if not 0 <= self.degree <= 3:
            raise ValueError(f"degree is {self.degree}; must be 0, 1, 2 or 3")


# Learning rates at the start and at the end, exponential between them. Those of 3D Gaussian splatting are
# for 30,000 steps; with a tenth of the steps the positions need larger ones. Positions are in units of
# the views' mean distance to what they see, divided by the focal length: pixels.
_RATES = {
    "means": (0.15, 0.006),
    "log_scales": (0.01, 0.002),
    "rotations": (0.004, 0.001),
    "opacity_logits": (0.05, 0.01),
    "sh_constant": (0.008, 0.0012),
    "sh_directional": (0.0008, 0.0002),
}


class Trainer:
    """Trains one layer of Gaussians; its whole state can be saved between two steps and restored.

    Args:
        arrays: the backend's array types.
        views: what to learn from, all of one size.
        settings: how.
    """

    def __init__(self, arrays: Arrays, views: list[TrainingView], settings: TrainingSettings):
        self.arrays, self.views, self.settings = arrays, views, settings
        self._targets = [Target(torch.from_numpy(v.radiance)) for v in views]
        self._pixel = _pixel_footprint(views)
        self.density = DensityControl(settings.iterations, settings.gaussians)
        rng = np.random.default_rng([settings.seed, 0])
        initial = seed_from_views(views, self.density.initial_count, settings.degree, rng)
        self.iteration = 0
        self._install(initial, None)

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as they are now, without gradients."""
        sh = torch.cat([self._leaves["sh_constant"], self._leaves["sh_directional"]]).detach()
        return Gaussians(**{n: self._leaves[n].detach() for n in _GEOMETRY}, sh=sh)

    def run(self, progress: Callable[[int], None] = lambda done: None, until: int | None = None) -> None:
        """Trains up to iteration `until`, by default to the end."""
        while self.iteration < (until or self.settings.iterations):
            self._step()
            self.iteration += 1
            progress(self.iteration)

    def _step(self) -> None:
        index = self._view_of(self.iteration)
        self._set_rates()
        leaves = self._leaves
        sh = torch.cat([leaves["sh_constant"], leaves["sh_directional"]])
        gaussians = Gaussians(**{name: leaves[name] for name in _GEOMETRY}, sh=sh)
        image = render_differentiable(self.arrays, gaussians, self.views[index].camera, PIXEL_FILTER)
        loss, error = self._targets[index].loss(image)
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step()
        self.density.observe(index, error)
        if self.density.is_due(self.iteration):
            rng = np.random.default_rng([self.settings.seed, 1, self.iteration])
            kept, added = self.density.change(self.gaussians, self.views, rng)
            self._install(concatenated([self.gaussians.select(kept), added]), kept)

    def _view_of(self, iteration: int) -> int:
        """Each view once per round, in an order of its own for each round."""
        turn, place = divmod(iteration, len(self.views))
        return int(np.random.default_rng([self.settings.seed, 2, turn]).permutation(len(self.views))[place])

    def _set_rates(self) -> None:
        share = self.iteration / self.settings.iterations
        for group in self._optimizer.param_groups:
            start, end = _RATES[group["name"]]
            unit = self._pixel if group["name"] == "means" else 1.0
            group["lr"] = unit * math.exp((1 - share) * math.log(start) + share * math.log(end))

    def _install(self, gaussians: Gaussians, kept: torch.Tensor | None) -> None:
        """Makes Gaussians the ones that are optimized; the momenta of those that were kept stay."""
        before = getattr(self, "_optimizer", None)
        tensors = {name: getattr(gaussians, name) for name in _GEOMETRY}
        tensors |= {"sh_constant": gaussians.sh[:1], "sh_directional": gaussians.sh[1:]}
        self._leaves = {n: t.clone().contiguous().requires_grad_() for n, t in tensors.items()}
        groups = [{"params": [leaf], "name": name} for name, leaf in self._leaves.items()]
        self._optimizer = torch.optim.Adam(groups, lr=0.0, betas=(0.9, 0.999), eps=1e-15, fused=True)
        if before is None or kept is None:
            return
        for old, new in zip(before.param_groups, self._optimizer.param_groups, strict=True):
            state = before.state.get(old["params"][0])
            if state:
                leaf = new["params"][0]
                grown = {"step": state["step"].clone()}
                for moment in ("exp_avg", "exp_avg_sq"):
                    grown[moment] = torch.zeros_like(leaf)
                    grown[moment][..., : len(kept)] = state[moment][..., kept]
                self._optimizer.state[leaf] = grown

    def state(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Everything that the next step depends on: tensors, and numbers."""
        tensors: dict[str, torch.Tensor] = {}
        for group in self._optimizer.param_groups:
            name, leaf = group["name"], group["params"][0]
            tensors[f"leaf.{name}"] = leaf.detach()
            for moment, value in self._optimizer.state.get(leaf, {}).items():
                tensors[f"adam.{moment}.{name}"] = value
        tensors |= self.density.state()
        return tensors, {"iteration": self.iteration, "settings": asdict(self.settings)}

    def restore(self, tensors: dict[str, torch.Tensor], numbers: dict[str, Any]) -> None:
        """Inverse of `state`.

        Raises:
            ValueError: the state is that of a training with other settings.
        """
        if numbers["settings"] != asdict(self.settings):
            raise ValueError("the checkpoint is of a training with other settings")
        leaves = {n: tensors[f"leaf.{n}"] for n in (*_GEOMETRY, "sh_constant", "sh_directional")}
        sh = torch.cat([leaves["sh_constant"], leaves["sh_directional"]])
        self._install(Gaussians(**{name: leaves[name] for name in _GEOMETRY}, sh=sh), None)
        for group in self._optimizer.param_groups:
            moments = {m: tensors.get(f"adam.{m}.{group['name']}") for m in ("step", "exp_avg", "exp_avg_sq")}
            if moments["step"] is not None:
                self._optimizer.state[group["params"][0]] = moments
        self.density.restore(tensors)
        self.iteration = int(numbers["iteration"])


_GEOMETRY = ("means", "log_scales", "rotations", "opacity_logits")


def _pixel_footprint(views: list[TrainingView]) -> float:
    """Size of a pixel in world space at the mean distance of what the views see."""
    distances = [v.distance[np.isfinite(v.distance)] for v in views]
    seen = np.concatenate([d for d in distances if len(d)] or [np.ones(1, np.float32)])
    return float(np.median(seen)) / views[0].camera.fy
