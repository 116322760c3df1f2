"""Separates the nodes of a layer that move from those that stand still (Fov-GS, section 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from splat.model.dynamics import Dynamics
from splat.model.gaussians import Gaussians
from splat.model.layer import BACKGROUND, Layer
from splat.separation.contribution import contributions

# Share of what a node contributes that must be to moving pixels for it to be dynamic, as in the paper.
_DYNAMIC = 0.5
# Pixels that a node must contribute in all for its labels to be changed.
_LEAST_PIXELS = 0.5
# Part of the distance, beside its own size, by which a node may be off the surface that a view shows there.
_OFF = 0.003


class LabelledView(Protocol):
    """A view whose pixels are labelled."""

    @property
    def camera(self) -> Camera:
        """The view."""

    @property
    def distance(self) -> NDArray[np.float32]:
        """(H, W) along the ray to what is seen; inf where nothing is."""

    @property
    def time(self) -> float:
        """That it shows, from 0 to 1."""

    @property
    def instance(self) -> NDArray[np.int32] | None:
        """(H, W) the instance that moves and that a pixel shows, -1 for none; None if nothing moves."""


@dataclass(frozen=True)
class Evidence:
    """What N nodes contribute to labelled pixels.

    Attributes:
        sums: (N, 1 + L) pixels, of the background and of each of L instances.
        times: (N, 2) of the views in which each contributed most to what stands still and to what moves.
    """

    sums: torch.Tensor
    times: torch.Tensor

    @property
    def total(self) -> torch.Tensor:
        """(N,) pixels in all."""
        return self.sums.sum(dim=1)

    @property
    def share(self) -> torch.Tensor:
        """(N,) share of moving pixels, 0 of nodes that contribute nothing."""
        return self.sums[:, 1:].sum(dim=1) / self.total.clamp(min=1e-12)


def evidence_of(
    arrays: Arrays, layer: Layer, views: Sequence[LabelledView], motion: Dynamics, instances: int
) -> Evidence:
    """What nodes contribute to labelled pixels of views, each shown at the time of the view.

    A view tells of those nodes only that are where it sees a surface: one that something has left behind, or
    that does not follow it yet, is drawn in front of what stands still, but is no part of that.

    Args:
        arrays: the backend's array types.
        layer: N nodes, at rest.
        views: labelled, in the coordinates of the nodes.
        motion: of the instances.
        instances: L, more than the largest label.
    """
    count = len(layer)
    sums, times, most = torch.zeros(count, 1 + instances), torch.zeros(count, 2), torch.zeros(count, 2)
    for view in views:
        if view.instance is None:
            continue
        present = np.unique(view.instance)
        with torch.no_grad():
            shown = motion.shown(layer.gaussians, layer.semantic, view.time)
        weights = (view.instance[..., None] == present).astype(np.float32)
        found = contributions(arrays, shown, view.camera, weights)
        found[~_on_surface(shown, view)] = 0
        moves = torch.from_numpy(present != BACKGROUND)
        sides = torch.stack([found[:, ~moves].sum(dim=1), found[:, moves].sum(dim=1)], dim=1)
        times = torch.where(sides > most, view.time, times)
        most = torch.maximum(most, sides)
        sums[:, torch.from_numpy(present.astype(np.int64)) + 1] += found
    return Evidence(sums, times)


def _on_surface(shown: Gaussians, view: LabelledView) -> torch.Tensor:
    """(N,) whether Gaussians are where a view sees a surface, within their size."""
    means = shown.means.detach().T.double().numpy()
    with np.errstate(divide="ignore", invalid="ignore"):
        position, depth = view.camera.project(means)
    height, width = view.distance.shape
    inside = (depth > 0) & (position >= 0).all(axis=1) & (position < [width, height]).all(axis=1)
    column, row = np.where(inside[:, None], position, 0).astype(np.int64).T
    nearest, farthest = (sought(view.distance, 3)[row, column] for sought in (minimum_filter, maximum_filter))
    distance = np.linalg.norm(means - view.camera.position, axis=1)
    size = shown.log_scales.detach().max(dim=0).values.exp().numpy()
    off = size + _OFF * distance
    return torch.from_numpy(inside & (distance > nearest - off) & (distance < farthest + off))


def separated(layer: Layer, evidence: Evidence, motion: Dynamics) -> Layer:
    """The nodes with labels that follow what they contribute to.

    More than half of what a dynamic node contributes is to pixels of what moves; its instance is the one that
    it contributes most to. Nodes that hardly contribute keep their labels. A node whose labels change stays
    where it was shown when it contributed most to what its new labels say.

    Args:
        layer: N nodes, at rest.
        evidence: of these nodes.
        motion: of the instances.
    """
    known = evidence.total >= _LEAST_PIXELS
    moves = evidence.share > _DYNAMIC
    best = evidence.sums[:, 1:].argmax(dim=1).int()
    semantic = torch.where(moves, best, BACKGROUND).int()
    semantic = torch.where(known, semantic, layer.semantic)
    changed = semantic != layer.semantic
    gaussians = layer.gaussians
    times = torch.where(semantic >= 0, evidence.times[:, 1], evidence.times[:, 0])
    for time in torch.unique(times[changed]).tolist():
        index = torch.nonzero(changed & (times == time))[:, 0]
        with torch.no_grad():
            there = motion.shown(gaussians.select(index), layer.semantic[index], time)
            gaussians = _written(gaussians, index, motion.at_rest(there, semantic[index], time))
    return replace(layer, gaussians=gaussians, semantic=semantic, dynamic=semantic >= 0)


def _written(gaussians: Gaussians, index: torch.Tensor, part: Gaussians) -> Gaussians:
    """Gaussians, of which those at an index (M,) are others."""
    others = dict(part.tensors())
    return Gaussians(
        **{name: tensor.index_copy(-1, index, others[name]) for name, tensor in gaussians.tensors()}
    )
