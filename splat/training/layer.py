"""One layer of the forest while it is trained: its frames, its Gaussians under Adam, its density control."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from compose.camera.camera import Camera
from splat.base.arrays import Arrays
from splat.model.forest import NO_PARENT, Layer, joined, static_layer
from splat.model.gaussians import Gaussians
from splat.raster.differentiable import render_differentiable
from splat.raster.projection import PIXEL_FILTER
from splat.training.density import DensityControl
from splat.training.initialization import TrainingView
from splat.training.loss import Target

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
_GEOMETRY = ("means", "log_scales", "rotations", "opacity_logits")
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


def pixel_footprint(views: list[TrainingView]) -> float:
    """Size of a pixel in world space at the mean distance of what the views see."""
    distances = [v.distance[np.isfinite(v.distance)] for v in views]
    seen = np.concatenate([d for d in distances if len(d)] or [np.ones(1, np.float32)])
    return float(np.median(seen)) / views[0].camera.fy


def reduced(view: TrainingView, factor: int) -> TrainingView:
    """The view at 1 / factor of its resolution; rows and columns beyond the last whole pixel are left out."""
    if factor == 1:
        return view
    camera = view.camera
    height, width = camera.height // factor, camera.width // factor
    radiance = view.radiance[: height * factor, : width * factor]
    radiance = radiance.reshape(height, factor, width, factor, 3).mean(axis=(1, 3))
    # A mean of distances would lie between a table's edge and the floor; the middle one lies on one of them.
    middle = np.s_[factor // 2 : height * factor : factor, factor // 2 : width * factor : factor]
    return TrainingView(
        reduced_camera(camera, factor),
        np.ascontiguousarray(radiance),
        np.ascontiguousarray(view.distance[middle]),
        np.ascontiguousarray(view.normal[middle]),
    )


def reduced_camera(camera: Camera, factor: int) -> Camera:
    """The same view with pixels of factor x factor."""
    return replace(
        camera,
        width=camera.width // factor,
        height=camera.height // factor,
        fx=camera.fx / factor,
        fy=camera.fy / factor,
        cx=camera.cx / factor,
        cy=camera.cy / factor,
    )


class LayerTraining:
    """Trains one layer; its whole state can be saved between two steps and restored.

    Args:
        arrays: the backend's array types.
        views: frames at this layer's resolution.
        steps: how many steps this layer will get.
        seed: what its order of views and its new Gaussians depend on.
    """

    def __init__(self, arrays: Arrays, views: list[TrainingView], steps: int, seed: list[int]):
        self.arrays, self.views, self.steps, self._seed = arrays, views, steps, seed
        self._targets = [Target(torch.from_numpy(v.radiance)) for v in views]
        self._pixel = pixel_footprint(views)
        self.done = 0
        self.density: DensityControl | None = None
        self._tree: Layer

    def begin(self, layer: Layer, final_count: int) -> None:
        """Starts from these nodes; density control will bring their number to the final one."""
        self.density = DensityControl(self.steps, len(layer), final_count)
        self._install(layer, None)

    def extend(self, layer: Layer) -> None:
        """Goes on with the same nodes, with other parents perhaps, and new ones after them."""
        before = len(self._tree)
        if len(layer) == before:
            self._tree = layer
        else:
            self._install(layer, torch.arange(before))

    @property
    def layer(self) -> Layer:
        """The nodes as they are now, without gradients."""
        sh = torch.cat([self._leaves["sh_constant"], self._leaves["sh_directional"]]).detach()
        gaussians = Gaussians(**{n: self._leaves[n].detach() for n in _GEOMETRY}, sh=sh)
        return replace(self._tree, gaussians=gaussians)

    def step(self) -> torch.Tensor | None:
        """One frame, one step.

        Returns:
            If density control changed the nodes: (N,) for each node before, its index now, -1 if it is gone.
        """
        assert self.density is not None
        index = self._view_of(self.done)
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
        due = self.density.is_due(self.done)
        self.done += 1
        return self._change_density(self.density) if due else None

    def _change_density(self, density: DensityControl) -> torch.Tensor:
        before = self.layer
        rng = np.random.default_rng([*self._seed, 1, self.done])
        kept, added = density.change(before.gaussians, self.views, rng)
        self._install(joined([before.select(kept), static_layer(added)]), kept)
        now = torch.full((len(before),), NO_PARENT, dtype=torch.int32)
        now[kept] = torch.arange(len(kept), dtype=torch.int32)
        return now

    def _view_of(self, step: int) -> int:
        """Each view once per round, in an order of its own for each round."""
        turn, place = divmod(step, len(self.views))
        return int(np.random.default_rng([*self._seed, 2, turn]).permutation(len(self.views))[place])

    def _set_rates(self) -> None:
        share = self.done / self.steps
        for group in self._optimizer.param_groups:
            start, end = _RATES[group["name"]]
            unit = self._pixel if group["name"] == "means" else 1.0
            group["lr"] = unit * math.exp((1 - share) * math.log(start) + share * math.log(end))

    def _install(self, layer: Layer, kept: torch.Tensor | None) -> None:
        """Makes nodes the ones that are optimized; the momenta of those that were kept stay."""
        before = getattr(self, "_optimizer", None)
        gaussians = layer.gaussians
        self._tree = layer
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
        if self.density is None:
            return {}, {"done": 0}
        tensors: dict[str, torch.Tensor] = {
            "parent": self._tree.parent,
            "semantic": self._tree.semantic,
            "dynamic": self._tree.dynamic,
        }
        for group in self._optimizer.param_groups:
            name, leaf = group["name"], group["params"][0]
            tensors[f"leaf.{name}"] = leaf.detach()
            for moment, value in self._optimizer.state.get(leaf, {}).items():
                tensors[f"adam.{moment}.{name}"] = value
        counts = {"initial": self.density.initial_count, "final": self.density.final_count}
        return tensors | self.density.state(), {"done": self.done, **counts}

    def restore(self, tensors: dict[str, torch.Tensor], numbers: dict[str, Any]) -> None:
        """Inverse of `state`."""
        if "initial" not in numbers:
            return
        leaves = {n: tensors[f"leaf.{n}"] for n in (*_GEOMETRY, "sh_constant", "sh_directional")}
        sh = torch.cat([leaves["sh_constant"], leaves["sh_directional"]])
        gaussians = Gaussians(**{name: leaves[name] for name in _GEOMETRY}, sh=sh)
        labels = (tensors[name] for name in ("parent", "semantic", "dynamic"))
        self._install(Layer(gaussians, *labels), None)
        for group in self._optimizer.param_groups:
            moments = {m: tensors.get(f"adam.{m}.{group['name']}") for m in _MOMENTS}
            if moments["step"] is not None:
                self._optimizer.state[group["params"][0]] = moments
        self.density = DensityControl(self.steps, int(numbers["initial"]), int(numbers["final"]))
        self.density.restore(tensors)
        self.done = int(numbers["done"])
