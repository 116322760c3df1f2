"""Rigid motion of instances: where the dynamic nodes of a forest are at a time.

Fov-GS deforms every dynamic Gaussian by a network (section 3.4). Where instances move rigidly, six numbers
per instance and time say as much, at next to no cost.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch

from compose.base.steps import between_steps
from compose.camera.place import Place
from splat.model.gaussians import Gaussians


@dataclass(frozen=True)
class Poses:
    """Where L instances are at one time: a point p at rest is at rotation p + offset.

    Attributes:
        rotations: (L, 4) float64, unit quaternions (w, x, y, z).
        offsets: (L, 3) float64.
    """

    rotations: torch.Tensor
    offsets: torch.Tensor

    def inverse(self) -> Poses:
        """The way back to rest."""
        back = self.rotations * self.rotations.new_tensor([1, -1, -1, -1])
        return Poses(back, -turned(back.T, self.offsets.T).T)


@dataclass(frozen=True)
class RigidMotion:
    """The courses of L instances, from T poses each.

    Attributes:
        rotations: (T, L, 4) float64, unit quaternions (w, x, y, z) from rest, at T equal steps of time from 0
            to 1; two or more.
        centres: (L, 3) float64, points at rest; between two steps, they move in a straight line.
        shifts: (T, L, 3) float64, how far the centres are from rest.

    Raises:
        ValueError: a tensor has the wrong shape or type.
    """

    rotations: torch.Tensor
    centres: torch.Tensor
    shifts: torch.Tensor

    def __post_init__(self) -> None:
        steps, count = self.rotations.shape[:2] if self.rotations.ndim == 3 else (0, 0)
        expected = {"rotations": (steps, count, 4), "centres": (count, 3), "shifts": (steps, count, 3)}
        for name, shape in expected.items():
            tensor = getattr(self, name)
            if tuple(tensor.shape) != shape or tensor.dtype != torch.float64:
                raise ValueError(
                    f"{name} is {tensor.dtype} of {tuple(tensor.shape)}, expected float64 of {shape}"
                )
        if steps < 2:
            raise ValueError(f"{steps} poses; must be two or more")

    def tensors(self) -> dict[str, torch.Tensor]:
        """All numbers, by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __len__(self) -> int:
        """Number of instances."""
        return len(self.centres)

    def at(self, time: float) -> Poses:
        """The poses at a time from 0 to 1."""
        first, share = between_steps(time, len(self.rotations))
        rotations = _between(self.rotations[first], self.rotations[first + 1], share)
        shifts = torch.lerp(self.shifts[first], self.shifts[first + 1], share)
        return Poses(rotations, self.centres + shifts - turned(rotations.T, self.centres.T).T)

    def placed(self, place: Place) -> RigidMotion:
        """The motion in the coordinates of a place, from that in world space."""
        origin = torch.tensor(place.origin, dtype=torch.float64)
        return replace(self, centres=(self.centres - origin) / place.unit, shifts=self.shifts / place.unit)


def posed(gaussians: Gaussians, instance: torch.Tensor, poses: Poses) -> Gaussians:
    """Gaussians where they are at a time; torch can differentiate them by those at rest.

    Their spherical harmonics stay as they are: radiance depends on where light comes from, which stays.

    Args:
        gaussians: N Gaussians at rest.
        instance: (N,) which instance each belongs to; below 0, it stays where it is.
        poses: of the instances.
    """
    moving = torch.nonzero(instance >= 0)[:, 0]
    if not len(moving):
        return gaussians
    of = instance[moving].long()
    rotations = poses.rotations[of].T.to(gaussians.means.dtype)
    offsets = poses.offsets[of].T.to(gaussians.means.dtype)
    means = turned(rotations, gaussians.means[:, moving]) + offsets
    orientations = multiplied(rotations, gaussians.rotations[:, moving])
    return replace(
        gaussians,
        means=gaussians.means.index_copy(1, moving, means),
        rotations=gaussians.rotations.index_copy(1, moving, orientations),
    )


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
    whole = torch.where(near, torch.ones_like(angle), torch.sin(angle))
    one = torch.where(near, torch.full_like(angle, 1 - share), torch.sin((1 - share) * angle) / whole)
    other = torch.where(near, torch.full_like(angle, share), torch.sin(share * angle) / whole)
    mixed = one * a + other * b
    return mixed / mixed.norm(dim=1, keepdim=True)
