"""Light that changes over time: at points of surfaces, and on the nodes of a forest, trained and drawn.

Fov-GS names what moves over still things as its limit (section 6): shadows, lights, or what moves under
these. Here some nodes, and only they, have a factor on their radiance at some times; those of something thin
have one for each of its sides.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from scipy.spatial import cKDTree

from compose.camera.camera import Camera, between_steps
from compose.camera.coordinate_systems import Place
from splat.model.gaussians import (
    SH_DC,
    Directional,
    Gaussians,
    perceptual_from_radiance,
    radiance_from_perceptual,
)
from splat.model.motion import multiplied, turned
from splat.model.points import Bits, Floats, Ints
from splat.model.trees import Layer

# Radiance below which a factor has nothing to change.
_DARK = 1e-4


@dataclass(frozen=True)
class LightCourse:
    """Factors on the radiance of M nodes of a forest.

    ValueError if a tensor has the wrong shape or type, or a sided node is none of the M.
    """

    nodes: torch.Tensor  # (M,) int64, their indices in the forest, ascending
    # (T, 3, M) float16, 0 or more, of each channel at T equal steps of time from 0 to 1; T is two or more.
    factors: torch.Tensor
    # (B,) int64, which of the M have other factors for those who see them from behind.
    sided: torch.Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.int64))
    # (T, 3, B) float16, these factors.
    behind: torch.Tensor = field(default_factory=lambda: torch.zeros(2, 3, 0, dtype=torch.float16))
    # (3, B) float32, from those nodes at rest to where they are seen from in front.
    normals: torch.Tensor = field(default_factory=lambda: torch.zeros(3, 0))

    def __post_init__(self) -> None:
        _require_factors("nodes and factors", self.nodes, self.factors)
        _require_factors("sided and behind", self.sided, self.behind)
        if self.normals.shape != (3, len(self.sided)) or self.normals.dtype != torch.float32:
            raise ValueError(f"normals of {tuple(self.normals.shape)}; must be float32 (3, B)")
        if len(self.sided):
            if len(self.behind) != len(self.factors):
                raise ValueError(f"factors at {len(self.factors)} and {len(self.behind)} times")
            if int(self.sided.min()) < 0 or int(self.sided.max()) >= len(self.nodes):
                raise ValueError(f"sides of more than {len(self.nodes)} nodes")

    def tensors(self) -> dict[str, torch.Tensor]:
        """All numbers, by name."""
        return dict(vars(self))

    def among(self, first: int, end: int) -> LightCourse:
        """The course of those nodes alone whose indices are from first up to end."""
        kept = (self.nodes >= first) & (self.nodes < end)
        position = torch.cumsum(kept, 0) - 1
        sided = kept[self.sided]
        both = self.factors[..., kept], position[self.sided[sided]], self.behind[..., sided]
        return LightCourse(self.nodes[kept], *both, self.normals[:, sided])


def _require_factors(what: str, nodes: torch.Tensor, factors: torch.Tensor) -> None:
    right = nodes.ndim == 1 and factors.shape[1:] == (3, len(nodes))
    if not right or nodes.dtype != torch.int64 or factors.dtype != torch.float16:
        shapes = f"{tuple(nodes.shape)} and {tuple(factors.shape)}"
        raise ValueError(f"{what} of {shapes}; must be int64 (M,) and float16 (T, 3, M)")
    if len(factors) < 2:
        raise ValueError(f"factors at {len(factors)} times; must be two or more")


def factors_at(factors: torch.Tensor, time: float) -> torch.Tensor:
    """(3, M) float32 factors at a time, from those (T, 3, M) at T equal steps of time from 0 to 1."""
    first, share = between_steps(time, len(factors))
    return torch.lerp(factors[first].float(), factors[first + 1].float(), share)


def seen_from_behind(
    normals: torch.Tensor, rest: torch.Tensor, rotations: torch.Tensor, means: torch.Tensor, eye: torch.Tensor
) -> torch.Tensor:
    """(B,) whether nodes, with centres (3, B) now, are seen from behind by an eye (3,).

    Normals (3, B) point to the front at rest; rotations (4, B), at rest and now, may have any length.
    """
    turn = multiplied(rotations, rest * rest.new_tensor([1, -1, -1, -1])[:, None])
    now = turned(turn / turn.norm(dim=0, keepdim=True).clamp(min=1e-12), normals)
    return (now * (eye[:, None] - means)).sum(dim=0) < 0


def in_light(gaussians: Gaussians, nodes: torch.Tensor, factor: torch.Tensor) -> Gaussians:
    """Gaussians, of which the radiance of those at an index (M,) has factors (3, M).

    The factors are exact for the mean over directions; what depends on direction is scaled as much.
    """
    sh, further = gaussians.sh[..., nodes], gaussians.directional
    mean = 0.5 + SH_DC * sh[0]
    radiance = radiance_from_perceptual(mean.clamp(min=0))
    change = perceptual_from_radiance(radiance * factor) / mean.clamp(min=_DARK)
    change = torch.where(radiance > _DARK, change, torch.ones_like(change))
    constant = (mean * change - 0.5) / SH_DC
    if further is not None:
        whole = torch.ones_like(gaussians.means).index_copy(1, nodes, change)
        further = Directional(further.index, further.sh * whole[:, further.index])
    lit = gaussians.sh.index_copy(2, nodes, torch.cat([constant[None], sh[1:] * change]))
    return replace(gaussians, sh=lit, directional=further)


# A node has the light of the nearest point if that is within so many gaps between points there.
_REACH = 8.0
# Which neighbour of a point tells the gap.
_NEIGHBOUR = 4
# Among so many neighbours of a point is one of the other side of something thin; most product of normals.
_AROUND, _OPPOSITE = 32, -0.3
# Neighbours that tell how light changes from place to place, and the least product of their normals: light
# that changes around a corner is no edge of a shadow.
_NEIGHBOURS, _ALIKE = 6, 0.7
# Times that tell it, about.
_SAMPLED = 32
# Of the curve on which radiance is compared, about.
_GAMMA = 2.2


@dataclass(frozen=True)
class SurfaceLight:
    """Light at P points of surfaces, each seen from one side."""

    means: torch.Tensor  # (3, P) float32, the points at rest
    normals: torch.Tensor  # (3, P) float32, at rest, towards where each was seen from
    instance: torch.Tensor  # (P,) int32, what moves them; -1 for nothing
    # (T, 3, P) float16, irradiance of each channel over what is usual there, at equal steps of time, 0 to 1
    factors: torch.Tensor
    changes: torch.Tensor  # (P,) bool, whether that is more than noise

    def __len__(self) -> int:
        return len(self.instance)

    def placed(self, place: Place) -> SurfaceLight:
        """The same points in the coordinates of a place, from world space."""
        means = place.from_world(self.means.T.numpy()).T
        return replace(self, means=torch.from_numpy(means).float())

    @cached_property
    def _apart(self) -> float:
        return 4 * float(np.ptp(self.means.numpy(), axis=1).max()) + 1.0

    def _keys(self, means: torch.Tensor, instance: torch.Tensor) -> Floats:
        """(N, 4) points among which those of other instances are never the nearest."""
        own = instance.clamp(min=-1).double() * self._apart
        return torch.cat([means.detach().double(), own[None]]).T.numpy()

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._keys(self.means, self.instance))

    def _neighbours(self, count: int) -> tuple[Floats, Ints]:
        """(P, K) distances and indices of the K nearest points of each one, itself first; K <= `count`."""
        return self._tree.query(self._tree.data, k=np.arange(1, min(count, len(self)) + 1))

    @cached_property
    def _around(self) -> tuple[Floats, torch.Tensor]:
        """(P,) gap to other points, and (P,) index of a point of the other side, the point itself if none."""
        away, near = self._neighbours(_AROUND)
        gap = away[:, min(_NEIGHBOUR, away.shape[1] - 1)]
        normals = self.normals.numpy().T
        opposite = np.einsum("pi,pki->pk", normals, normals[near]) < _OPPOSITE
        opposite &= away < self._apart / 2
        first = near[np.arange(len(self)), opposite.argmax(axis=1)]
        return gap, torch.from_numpy(np.where(opposite.any(axis=1), first, np.arange(len(self))))

    @cached_property
    def _unevenness(self) -> Floats:
        """(P,) mean squared change of the perceived light per distance from a point, over many times."""
        sampled = self.factors[:: max(1, len(self.factors) // _SAMPLED)]
        perceived = sampled.float().numpy() ** np.float32(1 / _GAMMA)
        away, near = self._neighbours(_NEIGHBOURS + 1)
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
        """(N,) how much light differs around nodes with centres (3, N) at rest, of instances (N,), over time.

        The squared difference of the perceived factors between two places, over their distance, on which it
        does not depend where edges of shadows pass.
        """
        nearest, within = self._nearest(means, instance)
        return torch.from_numpy(np.where(within, self._unevenness[nearest], 0)).float()

    def _nearest(self, means: torch.Tensor, instance: torch.Tensor) -> tuple[Ints, Bits]:
        """(N,) the nearest point of each node, and (N,) whether it is near enough to tell its light."""
        away, nearest = self._tree.query(self._keys(means, instance))
        return nearest, away <= _REACH * self._around[0][nearest]

    def near(self, means: torch.Tensor, instance: torch.Tensor) -> torch.Tensor:
        """(2, N) int64 points that nodes have their light from, seen from in front and from behind.

        -1 for nodes whose light does not change; the same point twice for what has one side only. The nodes'
        centres (3, N) are those at rest.
        """
        nearest, within = self._nearest(means, instance)
        front = torch.from_numpy(nearest)
        back = self._around[1][front]
        lit = torch.from_numpy(within) & (self.changes[front] | self.changes[back])
        return torch.where(lit, torch.stack([front, back]), -1)

    def course(self, nodes: Layer) -> LightCourse | None:
        """The light on nodes over time; None if it changes on none of them."""
        near = self.near(nodes.gaussians.means, nodes.semantic)
        lit = torch.nonzero(near[0] >= 0)[:, 0]
        if not len(lit):
            return None
        front, back = near[:, lit]
        sided = torch.nonzero(front != back)[:, 0]
        behind, normals = self.factors[..., back[sided]], self.normals[:, front[sided]]
        return LightCourse(lit, self.factors[..., front], sided, behind, normals)


# Names in checkpoints.
_STATE = "light.front", "light.back"
# Factor below which a pixel tells nothing of the radiance in usual light.
_LEAST = 0.1


class NodeLight:
    """The light that a layer's nodes have from points of surfaces, in the coordinates of the nodes."""

    def __init__(self, surface: SurfaceLight):
        self.surface = surface
        self._near = torch.zeros(2, 0, dtype=torch.int64)

    def follow(self, layer: Layer) -> None:
        """Finds the points that are nearest to the nodes as they are now."""
        self._near = self.surface.near(layer.gaussians.means, layer.semantic)

    def lit(
        self, rest: Gaussians, shown: Gaussians, index: torch.Tensor, camera: Camera, time: float
    ) -> Gaussians:
        """Shown nodes of the layer, by their indices (M,), in their light; torch can differentiate them."""
        return in_light(shown, *self._factor(self._near[:, index], rest, shown, camera, time))

    def in_usual_light(self, layer: Layer, shown: Gaussians, camera: Camera, time: float) -> Layer:
        """Nodes at rest that have the radiance seen by a camera, with that in usual light instead."""
        near = self.surface.near(layer.gaussians.means, layer.semantic)
        changed, factor = self._factor(near, layer.gaussians, shown, camera, time)
        usual = in_light(layer.gaussians, changed, 1 / factor.clamp(min=_LEAST))
        return replace(layer, gaussians=usual)

    @torch.no_grad()
    def _factor(
        self, near: torch.Tensor, rest: Gaussians, shown: Gaussians, camera: Camera, time: float
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Indices (C,) of those of M nodes whose light changes, and their factors (3, C)."""
        changed = torch.nonzero(near[0] >= 0)[:, 0]
        front, back = near[:, changed]
        turns, now, means = (t[:, changed] for t in (rest.rotations, shown.rotations, shown.means))
        eye = torch.from_numpy(camera.position.copy()).float()
        behind = seen_from_behind(self.surface.normals[:, front], turns, now, means, eye)
        return changed, factors_at(self.surface.factors, time)[:, torch.where(behind, back, front)]

    def state(self) -> dict[str, torch.Tensor]:
        """Tensors for a checkpoint."""
        return dict(zip(_STATE, self._near, strict=True))

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Restores what `state` returned; other tensors are ignored."""
        self._near = torch.stack([tensors[name] for name in _STATE])
