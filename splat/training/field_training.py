"""The training of a field: fitted to where frames see what moves, then optimized beside the Gaussians.

Images alone do not teach a field to follow what moves by more than its own size: no gradient leads from where
it is drawn to where it is seen. But a frame tells where in space the pixels of an instance are. Points that
one frame sees of it, the anchors, are deformed until they lie on what the other frames see (two-sided
distance to nearest points), while neighbours stay as far apart as they were (as rigid as possible; Sorkine
and Alexa 2007).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from compose.base.files import under
from compose.camera.camera import Camera
from splat.model.motion import LearnedMotion
from splat.training.training_view import TrainingView

# Steps at most, each on one frame.
_STEPS = 600
# Points of an instance in a frame, at most, of all instances together, and at least for a frame to tell.
_POINTS, _ALL_POINTS, _LEAST_POINTS = 150, 1000, 8
# Share of the frames that must show an instance: else too little is known of it.
_OFTEN = 0.5
# Anchors that each one keeps its distance to, and how much that counts beside the distance to what is seen.
_NEIGHBOURS, _RIGIDITY = 8, 3.0
# How much it counts that anchors are near what is seen: a frame sees one side of them only.
_UNSEEN = 0.5
# Learning rate at the end, as a share of that at the start.
_COOLED = 0.05
# Length that counts as none.
_TINY = 1e-6


@dataclass(frozen=True)
class _Anchors:
    index: torch.Tensor  # (A,) among the anchors of all instances
    size: float  # median distance from their centre
    neighbours: torch.Tensor  # neighbours, lengths: (A, K) nearest others, and how far they are at rest
    lengths: torch.Tensor


def register(motion: LearnedMotion, views: Sequence[TrainingView], steps: int, seed: int) -> None:
    """Fits the field of a motion to the instances that views show, and gives it their anchors.

    It takes no more steps than the training that follows.
    """
    rng = np.random.default_rng([seed, 4])
    clouds, references = _clouds(views, rng)
    frames = [(view, cloud) for view, cloud in zip(views, clouds, strict=True) if cloud]
    if not frames:
        return
    points = torch.cat(list(references.values()))
    instance = torch.cat([torch.full((len(of),), number) for number, of in references.items()])
    anchors = {number: _anchors(points, instance, number) for number in references}
    rate, _ = motion.field.RATES[""]
    adam = torch.optim.Adam(motion.field.parameters(), lr=rate)
    steps = min(steps, _STEPS)
    for step in range(steps):
        adam.param_groups[0]["lr"] = rate * _COOLED ** (step / steps)
        view, cloud = frames[int(rng.integers(len(frames)))]
        adam.zero_grad(set_to_none=True)
        shown = points + motion.field(points.T, view.time).shifts.T
        # How far all anchors are from what a frame sees, and from as rigid as possible.
        parts = [_strain(shown, one) for one in anchors.values()]
        for of, seen in cloud.items():
            parts.append(_distance(seen, shown[anchors[of].index], anchors[of], view.camera))
        torch.stack(parts).sum().backward()
        adam.step()
    adam.zero_grad(set_to_none=True)
    motion.anchors = points.T, instance


def _clouds(
    views: Sequence[TrainingView], rng: np.random.Generator
) -> tuple[list[dict[int, torch.Tensor]], dict[int, torch.Tensor]]:
    """For each view, some points (M, 3) of each instance of which it shows enough.

    And those of each instance in the view that shows most of it.
    """
    count = len({number for view in views for number in np.unique(view.instances(view.surface_pixels))})
    most = max(_LEAST_POINTS, min(_POINTS, _ALL_POINTS // max(1, count)))
    if not any(bool((view.instances(view.surface_pixels) < 0).any()) for view in views):
        # Labels that do not tell anything apart are none.
        return [{} for _ in views], {}
    found: list[dict[int, torch.Tensor]] = []
    times: Counter[int] = Counter()
    best: dict[int, tuple[int, torch.Tensor]] = {}
    for view in views:
        surface = np.setdiff1d(view.surface_pixels, view.sky_pixels, assume_unique=True)
        # A guess of a distance is not where anything is.
        surface = surface[:0] if view.guessed else surface
        instance = view.instances(surface)
        cloud = {}
        for number in np.unique(instance[instance >= 0]).tolist():
            pixels = surface[instance == number]
            if len(pixels) < _LEAST_POINTS:
                continue
            chosen = rng.choice(pixels, min(most, len(pixels)), replace=False)
            cloud[number] = torch.from_numpy(view.points(chosen)).float()
            times[number] += 1
            if len(pixels) > best.get(number, (0,))[0]:
                best[number] = len(pixels), cloud[number]
        found.append(cloud)
    often = {number for number, seen in times.items() if seen >= _OFTEN * len(views)}
    found = [{number: cloud[number] for number in cloud if number in often} for cloud in found]
    return found, {number: best[number][1] for number in sorted(often)}


def _anchors(points: torch.Tensor, instance: torch.Tensor, number: int) -> _Anchors:
    index = torch.nonzero(instance == number)[:, 0]
    own = points[index]
    lengths, neighbours = torch.cdist(own, own).topk(min(_NEIGHBOURS + 1, len(own)), largest=False)
    size = float((own - own.mean(dim=0)).norm(dim=1).median())
    return _Anchors(index, max(size, _TINY), index[neighbours[:, 1:]], lengths[:, 1:])


def _distance(cloud: torch.Tensor, shown: torch.Tensor, anchors: _Anchors, camera: Camera) -> torch.Tensor:
    """Mean distance between what a frame sees (M, 3) and anchors as shown (A, 3), in sizes of the instance.

    Anchors beside the frame could not be seen.
    """
    apart = torch.cdist(cloud, shown) / anchors.size
    _, inside = camera.shows(shown.detach().double().numpy())
    total = apart.amin(dim=1).mean()
    if inside.any():
        total = total + _UNSEEN * apart.amin(dim=0)[torch.from_numpy(inside)].mean()
    return total


def _strain(shown: torch.Tensor, anchors: _Anchors) -> torch.Tensor:
    """How much distances between neighbours differ from those at rest, in units of these."""
    lengths = (shown[anchors.index, None] - shown[anchors.neighbours]).norm(dim=2)
    return _RIGIDITY * (lengths - anchors.lengths).abs().mean() / max(float(anchors.lengths.mean()), _TINY)


# Share of the steps before the field is trained: the Gaussians become the mean of what is seen first.
_WARM_UP = 0.1
_LEAST = 1e-15
# Prefixes of tensors in checkpoints.
_VALUES, _MOMENTS = "values.", "moments."


class FieldOptimizer:
    """Optimizes the field of a learned motion in place, in a training of so many `steps`."""

    def __init__(self, motion: LearnedMotion, steps: int):
        self._motion, self.steps, self._rates = motion, steps, list(motion.field.RATES.values())
        groups: list[dict[str, Any]] = [{"params": []} for _ in self._rates]
        for name, parameter in motion.field.named_parameters():
            # The last one, without a name, takes all that no other one has.
            group = next(i for i, prefix in enumerate(motion.field.RATES) if name.startswith(prefix))
            groups[group]["params"].append(parameter)
        self._parameters = list(motion.field.parameters())
        self._adam = torch.optim.Adam(groups, lr=1.0, eps=_LEAST)

    def step(self, done: int, valid: bool) -> None:
        """Takes one step by the gradients, if they are `valid`: those of a finite loss; and clears them."""
        progress = done / self.steps
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
