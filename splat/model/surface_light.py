"""How the light on surfaces changes over time, at points of them, and what nodes of a forest make of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from compose.camera.place import Place
from splat.model.layer import Layer
from splat.model.light_course import LightCourse

# A node has the light of the nearest point if that is within so many gaps between points there.
_REACH = 8.0
# Which neighbour of a point tells the gap.
_NEIGHBOUR = 4
# Among so many neighbours of a point there is one of the other side of something thin, whose normal's
# product with that of the point is at most so much.
_AROUND, _OPPOSITE = 32, -0.3
# Neighbours of a point that tell how light changes from place to place, and the least product of their
# normals with its own: light that changes around a corner is no edge of a shadow.
_NEIGHBOURS, _ALIKE = 6, 0.7
# Times that tell it, about.
_SAMPLED = 32
# Of the curve on which radiance is compared, about.
_GAMMA = 2.2


@dataclass(frozen=True)
class Near:
    """Which points nodes have their light from.

    Attributes:
        front: (N,) int64 index of a point; -1 for a node whose light does not change.
        back: (N,) the same for those who see the node from behind; `front` for what has one side only.
    """

    front: torch.Tensor
    back: torch.Tensor

    def select(self, index: torch.Tensor) -> Near:
        """Those of nodes at an index (M,)."""
        return Near(self.front[index], self.back[index])


@dataclass(frozen=True)
class SurfaceLight:
    """Light at P points of surfaces, each seen from one side.

    Attributes:
        means: (3, P) float32, the points at rest.
        normals: (3, P) float32, at rest, towards where each was seen from.
        instance: (P,) int32, what moves them; -1 for nothing.
        factors: (T, 3, P) float16, irradiance of each channel over what is usual there, at T equal
            steps of time from 0 to 1.
        changes: (P,) bool, whether that is more than noise.
    """

    means: torch.Tensor
    normals: torch.Tensor
    instance: torch.Tensor
    factors: torch.Tensor
    changes: torch.Tensor

    def __len__(self) -> int:
        return len(self.instance)

    def placed(self, place: Place) -> SurfaceLight:
        """The same points in the coordinates of a place, from world space."""
        origin = torch.tensor(place.origin, dtype=torch.float64)[:, None]
        return replace(self, means=((self.means.double() - origin) / place.unit).float())

    @cached_property
    def _apart(self) -> float:
        """How far instances are moved apart, in the fourth axis in which neighbours are sought."""
        return 4 * float(np.ptp(self.means.numpy(), axis=1).max()) + 1.0

    def _keys(self, means: torch.Tensor, instance: torch.Tensor) -> NDArray[np.float64]:
        """(N, 4) points among which those of other instances are never the nearest."""
        own = instance.clamp(min=-1).double() * self._apart
        return torch.cat([means.detach().double(), own[None]]).T.numpy()

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._keys(self.means, self.instance))

    @cached_property
    def _around(self) -> tuple[NDArray[np.float64], torch.Tensor]:
        """(P,) gap to other points, and (P,) index of a point of the other side, the point itself if none."""
        count = min(_AROUND, len(self))
        away, near = (part.reshape(len(self), -1) for part in self._tree.query(self._tree.data, k=count))
        gap = away[:, min(_NEIGHBOUR, count - 1)]
        normals = self.normals.numpy().T
        opposite = np.einsum("pi,pki->pk", normals, normals[near]) < _OPPOSITE
        opposite &= away < self._apart / 2
        first = near[np.arange(len(self)), opposite.argmax(axis=1)]
        return gap, torch.from_numpy(np.where(opposite.any(axis=1), first, np.arange(len(self))))

    @cached_property
    def _unevenness(self) -> NDArray[np.float64]:
        """(P,) mean squared change of the perceived light per distance from a point, over many times."""
        sampled = self.factors[:: max(1, len(self.factors) // _SAMPLED)]
        perceived = sampled.float().numpy() ** np.float32(1 / _GAMMA)
        count = min(_NEIGHBOURS + 1, len(self))
        away, near = (part.reshape(len(self), -1) for part in self._tree.query(self._tree.data, k=count))
        normals = self.normals.numpy().T
        total, alike = np.zeros(len(self)), np.zeros(len(self))
        for distance, other in zip(away.T[1:], near.T[1:], strict=True):
            counts = np.einsum("pi,pi->p", normals, normals[other]) > _ALIKE
            counts &= (distance > 0) & (distance < self._apart / 2)
            change = ((perceived - perceived[..., other]) ** 2).mean(axis=(0, 1))
            total += np.where(counts, change / np.where(counts, distance, 1), 0)
            alike += counts
        return total / np.maximum(alike, 1)

    def unevenness(self, means: torch.Tensor, instance: torch.Tensor) -> torch.Tensor:
        """(N,) how much light differs around nodes, as a mean over time.

        The squared difference of the perceived factors between two places, over their distance. Where edges
        of shadows pass, it does not depend on that distance: the farther the places are apart, the longer
        an edge lies between them.

        Args:
            means: (3, N) centres at rest.
            instance: (N,) what moves them.
        """
        gap, _ = self._around
        away, nearest = self._tree.query(self._keys(means, instance))
        return torch.from_numpy(np.where(away <= _REACH * gap[nearest], self._unevenness[nearest], 0)).float()

    def near(self, means: torch.Tensor, instance: torch.Tensor) -> Near:
        """The points that nodes with centres (3, N) at rest, of instances (N,), have their light from."""
        gap, other = self._around
        away, nearest = self._tree.query(self._keys(means, instance))
        front = torch.from_numpy(nearest)
        back = other[front]
        lit = torch.from_numpy(away <= _REACH * gap[nearest]) & (self.changes[front] | self.changes[back])
        none = torch.full_like(front, -1)
        return Near(torch.where(lit, front, none), torch.where(lit, back, none))

    def course(self, nodes: Layer) -> LightCourse | None:
        """The light on nodes over time; None if it changes on none of them."""
        near = self.near(nodes.gaussians.means, nodes.semantic)
        lit = torch.nonzero(near.front >= 0)[:, 0]
        if not len(lit):
            return None
        front, back = near.front[lit], near.back[lit]
        sided = torch.nonzero(front != back)[:, 0]
        return LightCourse(
            lit,
            self.factors[..., front],
            sided,
            self.factors[..., back[sided]],
            self.normals[:, front[sided]],
        )
