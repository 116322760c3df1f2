"""Motion of instances, known or learned from frames: where the dynamic nodes of a forest are at a time.

Fov-GS deforms every dynamic Gaussian by a network (section 3.4). Where instances move rigidly, six numbers
per instance and time say as much, at next to no cost. An instance that deforms consists of pieces that move
nearly rigidly; each of its nodes follows the nearest of them (linear blend skinning, as the control points of
SC-GS, Huang et al. 2024).

A motion that nobody knows is a field that deforms Gaussians, of D-GS or 4DGS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from compose.camera.camera import between_steps
from compose.camera.coordinate_systems import Place
from splat.model.choices import FieldKind
from splat.model.gaussians import Gaussians

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
        return dict(vars(self))

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


@dataclass(frozen=True)
class Deformation:
    """How N Gaussians differ from those at rest."""

    shifts: Tensor  # (3, N) of their means
    turns: Tensor  # (4, N) that are added to their unit quaternions
    growths: Tensor  # (3, N) that are added to their log scales

    def applied(self, gaussians: Gaussians) -> Gaussians:
        """The Gaussians, deformed.

        D-GS adds growths after the exponential, where they can make scales negative; here they are added
        before it.
        """
        turned = gaussians.rotations / gaussians.rotations.norm(dim=0, keepdim=True) + self.turns
        moved, grown = gaussians.means + self.shifts, gaussians.log_scales + self.growths
        return replace(gaussians, means=moved, rotations=turned, log_scales=grown)


class Heads(torch.nn.Module):
    """Turns features (N, width) of points into their deformation, at first none."""

    def __init__(self, width: int, hidden: bool):
        super().__init__()
        for name, size in (("shifts", 3), ("turns", 4), ("growths", 3)):
            last = torch.nn.Linear(width, size)
            torch.nn.init.zeros_(last.weight)
            torch.nn.init.zeros_(last.bias)
            before = [torch.nn.Linear(width, width), torch.nn.ReLU()] if hidden else []
            self.add_module(name, torch.nn.Sequential(*before, last))

    def forward(self, features: Tensor) -> Deformation:
        return Deformation(*(head(features).T for head in self.children()))


# Frequencies of the positional encoding: of places, and of times as for synthetic scenes.
_PLACES, _TIMES = 10, 6
_NETWORK_WIDTH, _DEPTH = 256, 8
# The encoding is joined to the features again after the layer of this index.
_JOINED = 4


class DeformationNetwork(torch.nn.Module):
    """A perceptron of eight layers that sees a place and a time."""

    # Learning rates at the start and at the end.
    RATES: ClassVar = {"": (8e-4, 1.6e-6)}

    def __init__(self) -> None:
        super().__init__()
        width = 3 * (1 + 2 * _PLACES) + 1 + 2 * _TIMES
        inputs = [width, *(_NETWORK_WIDTH + width * (index == _JOINED) for index in range(_DEPTH - 1))]
        self.layers = torch.nn.ModuleList(torch.nn.Linear(size, _NETWORK_WIDTH) for size in inputs)
        self.heads = Heads(_NETWORK_WIDTH, hidden=False)

    def forward(self, means: Tensor, time: float) -> Deformation:
        """How Gaussians with means (3, N) are deformed at a time from 0 to 1."""
        times = means.new_full((means.shape[1], 1), time)
        encoded = torch.cat([_encoded(means.T, _PLACES), _encoded(times, _TIMES)], dim=1)
        features = encoded
        for index, layer in enumerate(self.layers):
            features = torch.relu(layer(features))
            if index == _JOINED:
                features = torch.cat([encoded, features], dim=1)
        return self.heads(features)


def _encoded(values: Tensor, frequencies: int) -> Tensor:
    """(N, C (1 + 2 F)) values (N, C), and sines and cosines of their multiples by 1, 2, 4, ..."""
    waves = [values]
    for power in range(frequencies):
        waves += [torch.sin(values * 2.0**power), torch.cos(values * 2.0**power)]
    return torch.cat(waves, dim=1)


# Features of a plane, and cells along an axis of space at each resolution, and along time.
_FEATURES, _SPACE, _TIME = 32, (64, 128), 25
_WIDTH = 64
# Pairs of the axes x, y, z, t.
_PAIRS = tuple(combinations(range(4), 2))


class HexPlane(torch.nn.Module):
    """Planes over each pair of the axes x, y, z and time, and a small perceptron.

    Places differ within a box with corners (3,). The regularizers (total variation of planes) are left out.
    """

    # Those of 4DGS are for 20,000 steps, a few times as many as are taken here, and as many times smaller.
    RATES: ClassVar = {"planes": (6.4e-3, 6.4e-4), "": (6.4e-4, 6.4e-5)}
    low: Tensor
    high: Tensor

    def __init__(self, low: Tensor, high: Tensor):
        super().__init__()
        self.register_buffer("low", low.float())
        self.register_buffer("high", high.float())
        self.planes = torch.nn.ParameterList()
        for space in _SPACE:
            for _, other in _PAIRS:
                # (1, F, cells of the second axis, of the first); over time, 1 at first as if nothing moved.
                shape = 1, _FEATURES, _TIME if other == 3 else space, space
                self.planes.append(torch.ones(shape) if other == 3 else torch.rand(shape) * 0.4 + 0.1)
        self.mix = torch.nn.Linear(_FEATURES * len(_SPACE), _WIDTH)
        self.heads = Heads(_WIDTH, hidden=True)

    def forward(self, means: Tensor, time: float) -> Deformation:
        size = (self.high - self.low).clamp(min=1e-6)
        places = 2 * (means.T - self.low) / size - 1
        at = torch.cat([places, means.new_full((means.shape[1], 1), 2 * time - 1)], dim=1)  # (N, 4)
        levels = []
        for level in range(len(_SPACE)):
            product = means.new_ones(means.shape[1], _FEATURES)
            for number, pair in enumerate(_PAIRS):
                plane, grid = self.planes[level * len(_PAIRS) + number], at[:, list(pair)][None, None]
                sampled = functional.grid_sample(plane, grid, align_corners=True, padding_mode="border")
                product = product * sampled[0, :, 0].T
            levels.append(product)
        return self.heads(torch.relu(self.mix(torch.cat(levels, dim=1))))


Field = DeformationNetwork | HexPlane
# Of instances, whose labels are 32-bit integers.
_ANY_NUMBER = 2**31 - 1


class LearnedMotion:
    """Deforms all nodes of any number of instances by a field in the coordinates of the nodes."""

    # Points (3, A) of instances (A,), at rest: what is shown comes to rest beside the nearest.
    anchors: tuple[Tensor, Tensor] | None = None

    def __init__(self, kind: FieldKind, field: Field):
        self.kind, self.field = kind, field

    @staticmethod
    def begun(kind: FieldKind, low: Tensor, high: Tensor, seed: int) -> LearnedMotion:
        """A motion before training, for nodes in a box with corners (3,)."""
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            field = DeformationNetwork() if kind is FieldKind.D_GS else HexPlane(low, high)
        return LearnedMotion(kind, field)

    @staticmethod
    def restored(tensors: dict[str, torch.Tensor]) -> LearnedMotion:
        """The motion whose `tensors` these are.

        KeyError, ValueError, RuntimeError if they are those of no field.
        """
        (kind,) = (FieldKind(name) for name in {name.split(".", 1)[0] for name in tensors})
        motion = LearnedMotion.begun(kind, torch.zeros(3), torch.ones(3), 0)
        motion.restore(tensors)
        motion.field.requires_grad_(False)
        return motion

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Becomes the motion of the same kind whose `tensors` these are."""
        self.field.load_state_dict({name.split(".", 1)[1]: tensor for name, tensor in tensors.items()})

    def shown(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        moving = torch.nonzero(instance >= 0)[:, 0]
        if len(moving) == len(gaussians):
            return self.field(gaussians.means, time).applied(gaussians)
        if not len(moving):
            return gaussians
        deformed = self.field(gaussians.means[:, moving], time).applied(gaussians.select(moving))
        parts = {name: getattr(deformed, name) for name in ("means", "rotations", "log_scales")}
        return gaussians.replaced(moving, **parts)

    def course(self, gaussians: Gaussians, instance: torch.Tensor) -> Callable[[float], Gaussians]:
        # A field knows nothing that all times share.
        return partial(self.shown, gaussians, instance)

    def at_rest(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        """The way back: as turned and as large as they are shown.

        Nodes are as far from rest as the nearest anchor of their instance; without anchors, as they would be
        if they were at rest where they are shown (first order).
        """
        with torch.no_grad():
            shifts = self.shown(gaussians, instance, time).means - gaussians.means
            if self.anchors is not None:
                points, of = self.anchors
                moved = self.field(points, time).shifts
                for number in torch.unique(of).tolist():
                    own, here = of == number, torch.nonzero(instance == number)[:, 0]
                    apart = torch.cdist(gaussians.means[:, here].T, (points + moved)[:, own].T)
                    shifts[:, here] = moved[:, own][:, apart.argmin(dim=1)]
        return replace(gaussians, means=gaussians.means - shifts)

    def tensors(self) -> dict[str, torch.Tensor]:
        """All numbers, by name, which begins with that of the field."""
        state = self.field.state_dict()
        return {f"{self.kind.value}.{name}": tensor.detach() for name, tensor in state.items()}

    def __len__(self) -> int:
        return _ANY_NUMBER


# Where nodes that belong to instances are at a time; `NodeMotion` says what both have.
Dynamics = NodeMotion | LearnedMotion
