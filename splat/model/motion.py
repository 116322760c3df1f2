"""Motion of instances: where the dynamic nodes of a forest are at a time.

Fov-GS deforms every dynamic Gaussian by a network (section 3.4). Where instances move rigidly, six numbers
per instance and time say as much, at next to no cost. An instance that deforms consists of pieces that move
nearly rigidly; each of its nodes follows the nearest of them (linear blend skinning, as the control points of
SC-GS, Huang et al. 2024).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import torch

from compose.camera.camera import between_steps
from compose.camera.coordinate_systems import Place
from splat.model.gaussians import Gaussians
from splat.model.learned_motion import LearnedMotion

# Pieces that a node follows, at most.
_FOLLOWED = 4
# Distance that counts as none.
_TINY = 1e-12


@dataclass(frozen=True)
class Poses:
    """Where the P pieces of L instances are at one time: a point p at rest is at rotation p + offset."""

    rotations: torch.Tensor  # (P, 4) float64, unit quaternions (w, x, y, z)
    offsets: torch.Tensor  # (P, 3) float64
    centres: torch.Tensor  # (P, 3) float64, points at rest
    pieces: torch.Tensor  # (L,) int64, number of pieces of each instance

    def inverse(self) -> Poses:
        """The way back to rest; exact for instances of one piece."""
        back = self.rotations * self.rotations.new_tensor([1, -1, -1, -1])
        there = turned(self.rotations.T, self.centres.T).T + self.offsets
        return Poses(back, -turned(back.T, self.offsets.T).T, there, self.pieces)

    def followed(self, means: torch.Tensor, instance: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(M, F) pieces that points (3, M) at rest, of instances (M,), follow, and weights that sum to one.

        A piece's weight falls with the distance of its centre, to zero at that of the nearest piece which is
        not followed any more: it changes without a jump along the instance.
        """
        first = torch.cumsum(self.pieces, 0) - self.pieces
        if bool((self.pieces == 1).all()):
            return first[instance][:, None], means.new_ones(len(instance), 1)
        # (M, P); pieces of other instances are infinitely far.
        distance = torch.cdist(means.T, self.centres.to(means.dtype))
        own = torch.repeat_interleave(torch.arange(len(self.pieces)), self.pieces)
        distance = torch.where(own == instance[:, None], distance, torch.inf)
        near, index = distance.topk(min(_FOLLOWED + 1, distance.shape[1]), dim=1, largest=False)
        # An instance with few pieces has them all followed. Infinities would have no gradient.
        known = torch.isfinite(near)
        farthest = 2 * torch.where(known, near, 0).amax(dim=1, keepdim=True).clamp(min=_TINY)
        beyond = torch.where(known[:, -1:], near[:, -1:], farthest)
        weights = (1 - torch.where(known, near, beyond) / beyond)[:, :_FOLLOWED].clamp(min=0) ** 2
        # A point as far from all pieces as from the nearest follows all alike.
        weights = weights + _TINY
        return index[:, :_FOLLOWED], weights / weights.sum(dim=1, keepdim=True)


@dataclass(frozen=True)
class NodeMotion:
    """The courses of L instances of P pieces, from T poses each.

    ValueError if a tensor has the wrong shape or type, or pieces do not sum up.
    """

    # (T, P, 4) float64, unit quaternions (w, x, y, z) from rest, at T >= 2 equal steps of time, 0 to 1
    rotations: torch.Tensor
    centres: torch.Tensor  # (P, 3) float64, points at rest; between two steps, they move in a straight line
    shifts: torch.Tensor  # (T, P, 3) float64, how far the centres are from rest
    pieces: torch.Tensor  # (L,) int64, number of pieces of each instance, one or more; P in all

    def __post_init__(self) -> None:
        steps, count = self.rotations.shape[:2] if self.rotations.ndim == 3 else (0, 0)
        expected = {"rotations": (steps, count, 4), "centres": (count, 3), "shifts": (steps, count, 3)}
        for name, shape in expected.items():
            kind, found = getattr(self, name).dtype, tuple(getattr(self, name).shape)
            if found != shape or kind != torch.float64:
                raise ValueError(f"{name} is {kind} of {found}, expected float64 of {shape}")
        if steps < 2:
            raise ValueError(f"{steps} poses; must be two or more")
        if self.pieces.ndim != 1 or self.pieces.dtype != torch.int64 or bool((self.pieces < 1).any()):
            raise ValueError("pieces must be int64 (L,), one or more each")
        if int(self.pieces.sum()) != count:
            raise ValueError(f"instances of {self.pieces.tolist()} pieces; there are poses of {count}")

    def tensors(self) -> dict[str, torch.Tensor]:
        """All numbers, by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __len__(self) -> int:
        """Number of instances."""
        return len(self.pieces)

    def at(self, time: float) -> Poses:
        """The poses at a time from 0 to 1."""
        first, share = between_steps(time, len(self.rotations))
        rotations = _between(self.rotations[first], self.rotations[first + 1], share)
        shifts = torch.lerp(self.shifts[first], self.shifts[first + 1], share)
        offsets = self.centres + shifts - turned(rotations.T, self.centres.T).T
        return Poses(rotations, offsets, self.centres, self.pieces)

    def shown(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        """Gaussians as they are at a time from 0 to 1; torch can differentiate them by those at rest.

        Those of an instance (N,) below 0 stay where they are.
        """
        return self.course(gaussians, instance)(time)

    def course(self, gaussians: Gaussians, instance: torch.Tensor) -> Callable[[float], Gaussians]:
        """`shown` of some Gaussians as a function of time: what all times share is found once."""
        # Which pieces a node follows is told at rest, whatever the time.
        followed = _followed(gaussians, instance, self.at(0.0))
        return lambda time: _posed(gaussians, followed, self.at(time))

    def at_rest(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        """The way back: at rest, Gaussians that are shown at a time; exact for instances of one piece."""
        return posed(gaussians, instance, self.at(time).inverse())

    def placed(self, place: Place) -> NodeMotion:
        """The motion in the coordinates of a place, from that in world space."""
        centres = torch.from_numpy(place.from_world(self.centres.numpy()))
        return replace(self, centres=centres, shifts=self.shifts / place.unit)


# Where nodes that belong to instances are at a time; `NodeMotion` says what both have.
Dynamics = NodeMotion | LearnedMotion


def posed(gaussians: Gaussians, instance: torch.Tensor, poses: Poses) -> Gaussians:
    """Gaussians of instances (N,) where they are at a time; torch can differentiate them by those at rest.

    Their spherical harmonics stay as they are: radiance depends on where light comes from, which stays.
    """
    return _posed(gaussians, _followed(gaussians, instance, poses), poses)


# Indices (M,) of Gaussians that follow pieces, then which pieces and how much as from `Poses.followed`.
_Followed = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


def _followed(gaussians: Gaussians, instance: torch.Tensor, poses: Poses) -> _Followed:
    moving = torch.nonzero(instance >= 0)[:, 0]
    return moving, *poses.followed(gaussians.means[:, moving], instance[moving].long())


def _posed(gaussians: Gaussians, followed: _Followed, poses: Poses) -> Gaussians:
    moving, pieces, weights = followed
    if not len(moving):
        return gaussians
    means, rotations = _blended(poses, pieces, weights, gaussians.means[:, moving])
    orientations = multiplied(rotations, gaussians.rotations[:, moving])
    return gaussians.replaced(moving, means=means, rotations=orientations)


def _blended(
    poses: Poses, index: torch.Tensor, weights: torch.Tensor, means: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Where points (3, M) at rest are, and unit quaternions (4, M) by which they have turned."""
    place, turn = torch.zeros_like(means), means.new_zeros(4, means.shape[1])
    leading = poses.rotations[index[:, 0]].T.to(means.dtype)
    for piece, weight in zip(index.T, weights.T, strict=True):
        rotations, offsets = poses.rotations[piece].T.to(means.dtype), poses.offsets[piece].T.to(means.dtype)
        place = place + weight * (turned(rotations, means) + offsets)
        # Either sign of a quaternion is the same turn.
        sign = torch.where((rotations * leading).sum(dim=0) < 0, -1.0, 1.0)
        turn = turn + weight * sign * rotations
    return place, turn / turn.norm(dim=0, keepdim=True)


def turned(quaternions: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """Points (3, N) turned by unit quaternions (4, N)."""
    w, axis = quaternions[:1], quaternions[1:]
    twice = 2 * torch.linalg.cross(axis, points, dim=0)
    return points + w * twice + torch.linalg.cross(axis, twice, dim=0)


def multiplied(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Products (4, N) of quaternions (4, N): the turn b, and then a."""
    w = a[:1] * b[:1] - (a[1:] * b[1:]).sum(dim=0, keepdim=True)
    xyz = a[:1] * b[1:] + b[:1] * a[1:] + torch.linalg.cross(a[1:], b[1:], dim=0)
    return torch.cat([w, xyz])


def _between(a: torch.Tensor, b: torch.Tensor, share: float) -> torch.Tensor:
    """Unit quaternions (L, 4) on the shorter arcs from a to b."""
    b = torch.where((a * b).sum(dim=1, keepdim=True) < 0, -b, b)
    angle = torch.acos((a * b).sum(dim=1, keepdim=True).clamp(-1, 1))
    near = angle < 1e-6
    whole = torch.where(near, 1, torch.sin(angle))
    one, other = (torch.where(near, part, torch.sin(part * angle) / whole) for part in (1 - share, share))
    mixed = one * a + other * b
    return mixed / mixed.norm(dim=1, keepdim=True)
