"""Density control: adds Gaussians where the image is wrong, removes unseen ones, splits large ones.

3D Gaussian splatting has no geometry and infers from gradients where Gaussians are missing. Here the path
tracer knows the distance of every pixel: new Gaussians are placed on the surface, at pixels drawn with
probability proportional to their error. In frames without distances, the Gaussians that are there tell them.

Nodes are split that are too large for the edges of the shadows that pass over them: a node has one factor of
light, and a shadow whose edge lies across a large one would have the node's shape instead of its own.

And Gaussians must stay small beside their distance from whoever looks at them. The rasterizer projects one
linearly around its centre: a large one on a wall close beside a viewer spills over all of the view.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from compose.base.files import under
from splat.model.dynamic_light import NodeLight, SurfaceLight
from splat.model.gaussians import SH_DC, Gaussians
from splat.model.motion import Dynamics, turned
from splat.model.trees import Layer, concatenated_layers, static_layer
from splat.raster.projection import NEAR
from splat.training.initialization import seed_at
from splat.training.training_view import TrainingView

_EVERY = 100  # iterations at most; short trainings have at least this many changes:
_CHANGES = 5
_FIRST, _LAST = 0.05, 0.6  # shares of the training between which the number changes
_MINIMUM_OPACITY = 0.02
_SIZE = 0.6  # standard deviation of an added Gaussian in pixels
# Views of guessed distances that get new Gaussians in a change: what they show has to be rendered first.
_MEASURED = 16

# Prefix of errors in checkpoints.
_STATE = "error."
# Gives a view whose distances are guesses those that Gaussians show.
_Measure = Callable[[TrainingView], TrainingView]


class DensityControl:
    """Decides when and how the set of Gaussians changes; motion and light are those that views show."""

    def __init__(
        self,
        iterations: int,
        initial_count: int,
        final_count: int,
        motion: Dynamics | None = None,
        light: NodeLight | None = None,
    ):
        self.iterations, self.initial_count, self.final_count = iterations, initial_count, final_count
        self._motion, self._light = motion, light
        self._errors: dict[int, torch.Tensor] = {}

    @property
    def _every(self) -> int:
        """Iterations from one change to the next."""
        return max(1, min(_EVERY, int((_LAST - _FIRST) * self.iterations) // _CHANGES))

    def observe(self, view: int, error: torch.Tensor) -> None:
        """Records a view's latest error per pixel (H, W)."""
        self._errors[view] = error

    def view_errors(self, count: int) -> NDArray[np.float64]:
        """(count,) mean of each view's latest error; NaN for one that was not seen yet."""
        means = {view: float(error.mean()) for view, error in self._errors.items()}
        return np.array([means.get(view, np.nan) for view in range(count)])

    def is_due(self, iteration: int) -> bool:
        """Whether the set changes after this iteration, counted from 0."""
        share = iteration / self.iterations
        return iteration % self._every == self._every - 1 and _FIRST <= share <= _LAST

    def change(
        self,
        gaussians: Gaussians,
        views: list[TrainingView],
        rng: np.random.Generator,
        measured: _Measure = lambda view: view,
    ) -> tuple[torch.Tensor, Layer]:
        """Indices (M,) of the Gaussians that stay, and new nodes, at rest, at pixels drawn at random."""
        opacity = torch.sigmoid(gaussians.opacity_logits)
        finite = torch.isfinite(gaussians.means).all(dim=0) & torch.isfinite(gaussians.log_scales).all(dim=0)
        kept = torch.nonzero((opacity >= _MINIMUM_OPACITY) & finite)[:, 0]
        # Black frames teach all to vanish; a layer without any node could not be drawn or built upon.
        kept = kept if len(kept) else opacity.argmax()[None]
        # In equal steps towards the final number, no matter how many were pruned.
        rounds = max(1, int((_LAST - _FIRST) * self.iterations / self._every))
        step = -(-(self.final_count - self.initial_count) // rounds)
        target = min(self.final_count, len(gaussians) + step)
        return kept, self._added(target - len(kept), views, gaussians.degree, rng, measured)

    def _added(
        self, count: int, views: list[TrainingView], degree: int, rng: np.random.Generator, measured: _Measure
    ) -> Layer:
        """New nodes, shared among the views in proportion to their mean errors, then among their pixels."""
        seen = sorted(self._errors)
        if any(views[v].guessed for v in seen):
            seen = sorted(rng.choice(seen, min(_MEASURED, len(seen)), replace=False).tolist())
        # The small term makes the shares equal, rather than 0 / 0, if there is no error at all.
        weights = np.array([float(self._errors[v].mean()) for v in seen]) + 1e-9
        shares = rng.multinomial(max(0, count), weights / weights.sum()) if seen else np.zeros(0, int)
        parts = [static_layer(Gaussians.none(degree))]
        for view, share in zip(seen, shares, strict=True):
            if share:
                shown, error = measured(views[view]), self._errors[view].numpy().ravel()
                likely = np.zeros(error.size)
                likely[shown.surface_pixels] = error[shown.surface_pixels]
                most, total = int(np.count_nonzero(likely)), likely.sum()
                if most:
                    pixels = rng.choice(error.size, min(int(share), most), replace=False, p=likely / total)
                    parts.append(seed_at(shown, pixels, _SIZE, degree, self._motion, self._light))
        return concatenated_layers(parts)

    def state(self) -> dict[str, torch.Tensor]:
        """Tensors for a checkpoint."""
        return {f"{_STATE}{view}": error for view, error in self._errors.items()}

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Restores what `state` returned; other tensors are ignored."""
        self._errors = {int(view): error for view, error in under(_STATE, tensors).items()}


# Error on the perceptual scale that a node may make by having one factor, as a root mean square over time:
# with less, there are more nodes, and `room-moving` is no better.
_ERROR = 0.03
# Least standard deviation of nodes that are split, in pixels of a view from the median distance.
_SMALLEST = 0.6
# A node is split that is larger by this factor than it may be.
_MARGIN = 1.3
# Steps that a layer must get for nodes to be split: halves have to become what they stand for.
LEAST_STEPS = 400
# Share of a layer's nodes that are split at once, at most.
_MOST = 0.1
# Deviation of a half along the split axis, and its distance from the middle, over the deviation of the whole.
_HALF, _ASIDE = 0.75, 0.6
# What a half has of its opacity in the middle of the whole, and the most that it has.
_MIDDLE, _MOST_OPAQUE = float(np.exp(-0.5 * (_ASIDE / _HALF) ** 2)), 0.99
# Of what is brighter, a display shows no difference.
_WHITE = 1.0


def too_large(layer: Layer, light: SurfaceLight, views: list[TrainingView]) -> torch.Tensor:
    """(N,) bool, which nodes that stand still are too large for the light that passes over them.

    The light on what moves changes all over it. Of many, those are named that exceed their limits most.
    """
    gaussians = layer.gaussians
    perceived = (0.5 + SH_DC * gaussians.sh[0]).clamp(0, _WHITE).mean(dim=0)
    uneven = light.unevenness(gaussians.means, layer.semantic) * perceived**2
    eyes = torch.from_numpy(np.stack([view.camera.position for view in views])).float()
    distance = torch.cdist(gaussians.means.T, eyes).median(dim=1).values
    # The smallest standard deviation that is worth splitting for.
    smallest = _SMALLEST * distance / float(np.median([view.camera.fy for view in views]))
    largest = torch.maximum(_ERROR**2 / uneven.clamp(min=1e-20), smallest)
    excess = gaussians.log_scales.max(dim=0).values - largest.log()
    found = (excess > np.log(_MARGIN)) & (layer.semantic < 0)
    most = int(_MOST * len(layer))
    if int(found.sum()) > most:
        excess[~found] = -torch.inf
        found = torch.zeros_like(found).index_fill(0, excess.topk(most).indices, True)
    return found


def halves(layer: Layer) -> Layer:
    """Two nodes instead of each, side by side along its longest axis; first all of one side.

    Together they are as opaque in the middle as the whole.
    """
    gaussians = layer.gaussians
    log_scales = gaussians.log_scales.clone()
    axis, each = log_scales.argmax(dim=0), torch.arange(len(layer))
    aside = torch.zeros_like(log_scales)
    aside[axis, each] = _ASIDE * log_scales[axis, each].exp()
    log_scales[axis, each] += float(np.log(_HALF))
    norm = gaussians.rotations.norm(dim=0, keepdim=True).clamp(min=1e-12)
    offset = turned(gaussians.rotations / norm, aside)
    opacity = (1 - torch.sigmoid(-gaussians.opacity_logits).sqrt()) / _MIDDLE
    logits = torch.logit(opacity, eps=1 - _MOST_OPAQUE)
    moved = (gaussians.means + side * offset for side in (1, -1))
    sides = (replace(gaussians, means=m, log_scales=log_scales, opacity_logits=logits) for m in moved)
    return concatenated_layers([replace(layer, gaussians=half) for half in sides])


# Longest axis, as a standard deviation, over the distance from the nearest training view.
_LARGEST = 0.12


def largest_log_scales(means: torch.Tensor, views: list[TrainingView]) -> torch.Tensor:
    """(N,) largest logarithm that the scales of Gaussians at means (3, N) may have, by how near views are."""
    eyes = cKDTree(np.stack([view.camera.position for view in views]))
    distance, _ = eyes.query(means.detach().T.double().numpy(), workers=-1)
    # What is nearer than the near plane is not drawn anyway.
    return torch.from_numpy(np.log(_LARGEST * np.maximum(distance, NEAR))).float()
