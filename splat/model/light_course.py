"""Nodes whose radiance changes over time, because shadows or lights pass over them, or they under these.

Fov-GS names what moves over still things as its limit (section 6). Here some nodes, and only they, have a
factor on their radiance at some times; those of something thin have one for each of its sides.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import torch

from compose.base.steps import between_steps
from splat.model.gaussians import SH_DC, Directional, Gaussians
from splat.model.motion import multiplied, turned
from splat.model.perceptual import perceptual_from_radiance, radiance_from_perceptual

# Radiance below which a factor has nothing to change.
_DARK = 1e-4


@dataclass(frozen=True)
class LightCourse:
    """Factors on the radiance of M nodes of a forest.

    Attributes:
        nodes: (M,) int64, their indices in the forest, ascending.
        factors: (T, 3, M) float16, 0 or more, of each channel at T equal steps of time from 0 to 1;
            T is two or more.
        sided: (B,) int64, which of the M have other factors for those who see them from behind.
        behind: (T, 3, B) float16, these factors.
        normals: (3, B) float32, from those nodes at rest to where they are seen from in front.

    Raises:
        ValueError: a tensor has the wrong shape or type, or a sided node is none of the M.
    """

    nodes: torch.Tensor
    factors: torch.Tensor
    sided: torch.Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.int64))
    behind: torch.Tensor = field(default_factory=lambda: torch.zeros(2, 3, 0, dtype=torch.float16))
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
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def among(self, first: int, end: int) -> LightCourse:
        """The course of those nodes alone whose indices are from first up to end."""
        kept = (self.nodes >= first) & (self.nodes < end)
        position = torch.cumsum(kept, 0) - 1
        sided = kept[self.sided]
        return LightCourse(
            self.nodes[kept],
            self.factors[..., kept],
            position[self.sided[sided]],
            self.behind[..., sided],
            self.normals[:, sided],
        )

    def at(self, time: float) -> torch.Tensor:
        """(3, M) factors at a time from 0 to 1, seen from in front."""
        return factors_at(self.factors, time)

    def behind_at(self, time: float) -> torch.Tensor:
        """(3, B) factors of sided nodes at a time from 0 to 1, seen from behind."""
        return factors_at(self.behind, time)


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
    normals: torch.Tensor,
    rest: torch.Tensor,
    rotations: torch.Tensor,
    means: torch.Tensor,
    eye: torch.Tensor,
) -> torch.Tensor:
    """(B,) whether nodes are seen from behind.

    Args:
        normals: (3, B) towards the front at rest.
        rest, rotations: (4, B) quaternions of the nodes at rest and now, of any length.
        means: (3, B) where they are now.
        eye: (3,) where they are seen from.
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
