"""Which nodes are on a surface that a view sees, and how far from it."""

from __future__ import annotations

from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from splat.model.gaussians import Gaussians

# Part of the distance, beside its own size, by which a node may be off a surface.
_OFF = 0.003
# Pixels to each side of the one that shows a node's centre, whose surfaces it may be on.
_AROUND = 1


class LabelledView(Protocol):
    """A view whose pixels are labelled."""

    @property
    def camera(self) -> Camera:
        """The view."""

    @property
    def distance(self) -> NDArray[np.float32]:
        """(H, W) along the ray to what is seen; inf where nothing is."""

    @property
    def normal(self) -> NDArray[np.float32]:
        """(H, W, 3) unit normal of what is seen; 0 where it is not known."""

    @property
    def guessed(self) -> bool:
        """Whether distances are guesses."""

    @property
    def time(self) -> float:
        """That it shows, from 0 to 1."""

    @property
    def instance(self) -> NDArray[np.int32] | None:
        """(H, W) the instance that moves and that a pixel shows, -1 for none; None if nothing moves."""


class Attachment:
    """Where N nodes are, compared with what a view sees there.

    Args:
        shown: the nodes, at the time of the view.
        view: in their coordinates.
        instance: (H, W) its labels.
    """

    def __init__(self, shown: Gaussians, view: LabelledView, instance: NDArray[np.int32]):
        self._view, self._instance = view, instance
        self._means = shown.means.detach().T.double().numpy()
        with np.errstate(divide="ignore", invalid="ignore"):
            position, depth = view.camera.project(self._means)
        size = [view.distance.shape[1], view.distance.shape[0]]
        self._inside = (depth > 0) & (position >= 0).all(axis=1) & (position < size).all(axis=1)
        self._column, self._row = np.where(self._inside[:, None], position, 0).astype(np.int64).T
        self._distance = np.linalg.norm(self._means - view.camera.position, axis=1)
        extent = shown.log_scales.detach().max(dim=0).values.exp().double().numpy()
        self._off = extent + _OFF * self._distance
        self._slope = _slope(view.distance)

    def on(self, labels: NDArray[np.int32]) -> NDArray[np.bool_]:
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

    def ways(self, label: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Ways (N, 3) to the planes of what is seen at centres, 0 where not near, and (N,) which are near.

        Args:
            label: that the surface must have.
        """
        at = self._row, self._column
        camera = self._view.camera
        centres = np.stack([self._column + 0.5, self._row + 0.5], axis=1)
        distance, normal = (
            self._view.distance[at].astype(np.float64),
            self._view.normal[at].astype(np.float64),
        )
        near = self._near(at) & (self._instance[at] == label) & (normal != 0).any(axis=1)
        near &= not self._view.guessed
        seen = camera.position + camera.rays(centres) * np.where(near, distance, 0)[:, None]
        way = ((seen - self._means) * normal).sum(axis=1, keepdims=True) * normal
        return np.where(near[:, None], way, 0), near

    def _near(self, at: tuple[NDArray[np.int64], NDArray[np.int64]]) -> NDArray[np.bool_]:
        """(N,) whether nodes are about as far away as what pixels (N,), around their centres, show."""
        near = np.abs(self._view.distance[at] - self._distance) < self._off + self._slope[at]
        return np.asarray(self._inside & near)


def _slope(distance: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) by how much distances change from a pixel to the next row and column, on the flatter sides."""
    total = np.zeros_like(distance)
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):
            step = np.abs(np.diff(distance, axis=axis))
        step = np.where(np.isfinite(step), step, np.inf)
        beyond = np.full_like(np.take(distance, [0], axis), np.inf)
        before, after = (np.concatenate(part, axis) for part in ([beyond, step], [step, beyond]))
        total += np.minimum(before, after)
    return np.where(np.isfinite(total), total, 0).astype(np.float32)
