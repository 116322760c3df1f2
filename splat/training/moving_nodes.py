"""Separates the nodes of a layer that move from those that stand still (Fov-GS, section 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import torch
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from splat.model.gaussians import Gaussians, written
from splat.model.motion import Dynamics
from splat.model.points import Bits, Floats, Ints
from splat.model.trees import BACKGROUND, Layer
from splat.raster.differentiable import contributions
from splat.training.training_view import TrainingView

# Part of the distance, beside its own size, by which a node may be off a surface.
_OFF = 0.003
# Pixels to each side of the one that shows a node's centre, whose surfaces it may be on.
_AROUND = 1


class Attachment:
    """Where N nodes are at the time of a view, compared with what it sees there, which has labels (H, W)."""

    def __init__(self, shown: Gaussians, view: TrainingView, instance: NDArray[np.int32]):
        self._view, self._instance = view, instance
        self._means = shown.means.detach().T.double().numpy()
        position, self._inside = view.camera.shows(self._means)
        self._column, self._row = np.where(self._inside[:, None], position, 0).astype(np.int64).T
        self._distance = np.linalg.norm(self._means - view.camera.position, axis=1)
        self._off = shown.longest.double().numpy() + _OFF * self._distance
        self._slope = _slope(view.distance)

    def on(self, labels: NDArray[np.int32]) -> Bits:
        """(N, C) whether nodes are, within their size, on a surface with a label (C,) around their centre.

        At an edge in the view, a node in front is so on the surface in front only.
        """
        height, width = self._instance.shape
        found = np.zeros((len(self._means), len(labels)), dtype=bool)
        steps = range(-_AROUND, _AROUND + 1)
        for down, right in product(steps, steps):
            at = np.clip(self._row + down, 0, height - 1), np.clip(self._column + right, 0, width - 1)
            found |= self._near(at)[:, None] & (self._instance[at][:, None] == labels)
        return found

    def ways(self, label: int) -> tuple[Floats, Bits]:
        """Ways (N, 3) to the planes of a label at centres, 0 where not near, and (N,) which are near."""
        at = self._row, self._column
        camera = self._view.camera
        centres = np.stack([self._column + 0.5, self._row + 0.5], axis=1)
        distance, normal = (a[at].astype(np.float64) for a in (self._view.distance, self._view.normal))
        near = self._near(at) & (self._instance[at] == label) & (normal != 0).any(axis=1)
        near &= not self._view.guessed
        seen = camera.position + camera.rays(centres) * np.where(near, distance, 0)[:, None]
        way = ((seen - self._means) * normal).sum(axis=1, keepdims=True) * normal
        return np.where(near[:, None], way, 0), near

    def _near(self, at: tuple[Ints, Ints]) -> Bits:
        """(N,) whether nodes are about as far away as what pixels (N,), around their centres, show."""
        near = np.abs(self._view.distance[at] - self._distance) < self._off + self._slope[at]
        return np.asarray(self._inside & near)


def _slope(distance: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) by how much distances change from a pixel to the next row and column, on the flatter sides."""
    total = np.zeros_like(distance)
    beyond = np.float32(np.nan)
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):
            steps = np.diff(distance, axis=axis, prepend=beyond), np.diff(distance, axis=axis, append=beyond)
        before, after = (np.where(np.isfinite(step), np.abs(step), np.inf) for step in steps)
        total += np.minimum(before, after)
    return np.where(np.isfinite(total), total, 0).astype(np.float32)


# Share of what a node contributes that must be to moving pixels for it to be dynamic, as in the paper.
_DYNAMIC = 0.5
# Pixels that a node must contribute in all for its labels to be changed; with less, no view shows it at all.
LEAST_PIXELS = 0.5


@dataclass(frozen=True)
class Evidence:
    """What N nodes contribute to labelled pixels."""

    # (N, 1 + L) pixels of the background and of each of L instances, whose surfaces they are on.
    sums: torch.Tensor
    # (N, 2) of the views in which each contributed most to what stands still and to what moves.
    times: torch.Tensor
    seen: torch.Tensor  # (N,) pixels in all, whatever surface they are on
    offsets: torch.Tensor  # (N, 3) mean ways to the surfaces of the background that views see there


def evidence_of(
    arrays: Arrays, layer: Layer, views: Sequence[TrainingView], motion: Dynamics, instances: int
) -> Evidence:
    """What nodes contribute to pixels of views, labelled by instances, each shown at the time of the view.

    A view tells of those nodes only that are on the surface that it sees, not of what is in front of it.
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
    """The nodes with labels that follow what they contribute to; those that hardly contribute keep theirs.

    More than half of what a dynamic node contributes is to pixels of what moves, most of it to its instance.
    A node whose labels change stays where it was shown when it contributed most to what its new labels say.
    One that stands still is put on the surface there, if it is farther from it than it is large.
    """
    # Pixels of what nodes are on the surface of.
    total = evidence.sums.sum(dim=1)
    known = total >= LEAST_PIXELS
    moves = evidence.sums[:, 1:].sum(dim=1) / total.clamp(min=1e-12) > _DYNAMIC
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
    # Of the background, on its surfaces within their size.
    hovers = (semantic == BACKGROUND) & (evidence.offsets.norm(dim=1) > gaussians.longest)
    means = gaussians.means + torch.where(hovers, evidence.offsets.T, 0)
    gaussians = replace(gaussians, means=means)
    return replace(layer, gaussians=gaussians, semantic=semantic, dynamic=semantic >= 0)
