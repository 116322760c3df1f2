"""Separates the nodes of a layer that move from those that stand still (Fov-GS, section 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from compose.base.arrays import Arrays
from splat.model.dynamics import Dynamics
from splat.model.gaussians import Gaussians, written
from splat.model.layer import BACKGROUND, Layer
from splat.separation.attachment import Attachment, LabelledView
from splat.separation.contribution import contributions

# Share of what a node contributes that must be to moving pixels for it to be dynamic, as in the paper.
_DYNAMIC = 0.5
# Pixels that a node must contribute in all for its labels to be changed.
_LEAST_PIXELS = 0.5


@dataclass(frozen=True)
class Evidence:
    """What N nodes contribute to labelled pixels.

    Attributes:
        sums: (N, 1 + L) pixels of the background and of each of L instances, whose surfaces they are on.
        times: (N, 2) of the views in which each contributed most to what stands still and to what moves.
        seen: (N,) pixels in all, whatever surface they are on.
        offsets: (N, 3) mean ways to the surfaces of the background that views see there.
    """

    sums: torch.Tensor
    times: torch.Tensor
    seen: torch.Tensor
    offsets: torch.Tensor

    @property
    def total(self) -> torch.Tensor:
        """(N,) pixels of what nodes are on the surface of."""
        return self.sums.sum(dim=1)

    @property
    def share(self) -> torch.Tensor:
        """(N,) share of moving pixels, 0 of nodes that contribute nothing."""
        return self.sums[:, 1:].sum(dim=1) / self.total.clamp(min=1e-12)

    @property
    def is_seen(self) -> torch.Tensor:
        """(N,) whether views show nodes at all."""
        return self.seen >= _LEAST_PIXELS


def evidence_of(
    arrays: Arrays, layer: Layer, views: Sequence[LabelledView], motion: Dynamics, instances: int
) -> Evidence:
    """What nodes contribute to labelled pixels of views, each shown at the time of the view.

    A view tells of those nodes only that are on the surface that it sees: one that something has left behind,
    or that does not follow it yet, is drawn in front of what stands still, but is no part of that.

    Args:
        arrays: the backend's array types.
        layer: N nodes, at rest.
        views: labelled, in the coordinates of the nodes.
        motion: of the instances.
        instances: L, more than the largest label.
    """
    count = len(layer)
    sums, times, most = torch.zeros(count, 1 + instances), torch.zeros(count, 2), torch.zeros(count, 2)
    seen, ways, weight = torch.zeros(count), torch.zeros(count, 3), torch.zeros(count)
    for view in views:
        if view.instance is None:
            continue
        with torch.no_grad():
            shown = motion.shown(layer.gaussians, layer.semantic, view.time)
        present = np.unique(view.instance)
        weights = (view.instance[..., None] == present).astype(np.float32)
        found = contributions(arrays, shown, view.camera, weights)
        seen += found.sum(dim=1)
        attachment = Attachment(shown, view, view.instance)
        found = torch.where(torch.from_numpy(attachment.on(present)), found, 0)
        moves = torch.from_numpy(present != BACKGROUND)
        sides = torch.stack([found[:, ~moves].sum(dim=1), found[:, moves].sum(dim=1)], dim=1)
        times = torch.where(sides > most, view.time, times)
        most = torch.maximum(most, sides)
        sums[:, torch.from_numpy(present.astype(np.int64)) + 1] += found
        way, near = attachment.ways(BACKGROUND)
        own = torch.where(torch.from_numpy(near), sides[:, 0], 0)
        ways, weight = ways + own[:, None] * torch.from_numpy(way).float(), weight + own
    return Evidence(sums, times, seen, ways / weight.clamp(min=1e-12)[:, None])


def separated(layer: Layer, evidence: Evidence, motion: Dynamics) -> Layer:
    """The nodes with labels that follow what they contribute to.

    More than half of what a dynamic node contributes is to pixels of what moves; its instance is the one that
    it contributes most to. Nodes that hardly contribute keep their labels. A node whose labels change stays
    where it was shown when it contributed most to what its new labels say. One that stands still is put on
    the surface that views see there, if it is farther from it than it is large.

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
            gaussians = written(gaussians, index, motion.at_rest(there, semantic[index], time))
    return replace(
        layer, gaussians=_attached(gaussians, semantic, evidence), semantic=semantic, dynamic=semantic >= 0
    )


def _attached(gaussians: Gaussians, semantic: torch.Tensor, evidence: Evidence) -> Gaussians:
    """Gaussians, of which those of the background are on its surfaces, within their size."""
    size = gaussians.log_scales.max(dim=0).values.exp()
    hovers = (semantic == BACKGROUND) & (evidence.offsets.norm(dim=1) > size)
    return replace(gaussians, means=gaussians.means + torch.where(hovers, evidence.offsets.T, 0))
