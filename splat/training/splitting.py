"""Splits nodes that are too large for the edges of the shadows that pass over them.

A node has one factor of light. Where an edge of a shadow lies across a large one, which is all that a plain
surface would need otherwise, the shadow has the node's shape instead of its own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from splat.model.gaussians import SH_DC
from splat.model.layer import Layer, concatenated_layers
from splat.model.motion import turned
from splat.model.surface_light import SurfaceLight
from splat.training.views import TrainingView

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
# Standard deviation of a half along the axis that is split, and its distance from the middle, as shares of
# the deviation of the whole: nearly the same moments.
_HALF, _ASIDE = 0.75, 0.6
# What a half has of its opacity in the middle of the whole, and the most that it has.
_MIDDLE, _MOST_OPAQUE = float(np.exp(-0.5 * (_ASIDE / _HALF) ** 2)), 0.99
# Of what is brighter, a display shows no difference.
_WHITE = 1.0


def too_large(layer: Layer, light: SurfaceLight, views: list[TrainingView]) -> torch.Tensor:
    """(N,) bool, which nodes that stand still are too large for the light that passes over them.

    The light on what moves changes all over it. Of many, those are named that exceed their limits most.

    Args:
        layer: N nodes, at rest.
        light: on the surfaces.
        views: of the training, in the same coordinates.
    """
    gaussians = layer.gaussians
    perceived = (0.5 + SH_DC * gaussians.sh[0]).clamp(0, _WHITE).mean(dim=0)
    uneven = light.unevenness(gaussians.means, layer.semantic) * perceived**2
    largest = torch.maximum(_ERROR**2 / uneven.clamp(min=1e-20), _smallest(gaussians.means, views))
    excess = gaussians.log_scales.max(dim=0).values - largest.log()
    found = (excess > np.log(_MARGIN)) & (layer.semantic < 0)
    most = int(_MOST * len(layer))
    if int(found.sum()) > most:
        excess[~found] = -torch.inf
        found = torch.zeros_like(found).index_fill(0, excess.topk(most).indices, True)
    return found


def _smallest(means: torch.Tensor, views: list[TrainingView]) -> torch.Tensor:
    """(N,) smallest standard deviation that is worth splitting for."""
    eyes = torch.from_numpy(np.stack([view.camera.position for view in views])).float()
    focal = float(np.median([view.camera.fy for view in views]))
    distance = torch.cdist(means.T, eyes).median(dim=1).values
    return _SMALLEST * distance / focal


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
    return concatenated_layers(
        [
            replace(
                layer,
                gaussians=replace(
                    gaussians,
                    means=gaussians.means + side * offset,
                    log_scales=log_scales,
                    opacity_logits=logits,
                ),
            )
            for side in (1, -1)
        ]
    )
