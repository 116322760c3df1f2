"""Nodes whose radiance changes over time, because shadows or lights pass over them.

Fov-GS names what moves over still things as its limit (section 6). Here some nodes, and only they, have a
factor on their radiance at some times.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch

from compose.base.steps import between_steps
from splat.model.gaussians import SH_DC
from splat.model.perceptual import perceptual_from_radiance, radiance_from_perceptual

# Radiance below which a factor has nothing to change.
_DARK = 1e-4


@dataclass(frozen=True)
class LightCourse:
    """Factors on the radiance of M nodes of a forest.

    Attributes:
        nodes: (M,) int64, their indices in the forest, ascending.
        factors: (T, M) float32, 0 or more, at T equal steps of time from 0 to 1; two or more.

    Raises:
        ValueError: a tensor has the wrong shape or type.
    """

    nodes: torch.Tensor
    factors: torch.Tensor

    def __post_init__(self) -> None:
        right = self.nodes.ndim == 1 and self.factors.ndim == 2 and self.factors.shape[1] == len(self.nodes)
        if not right or self.nodes.dtype != torch.int64 or self.factors.dtype != torch.float32:
            shapes = f"{tuple(self.nodes.shape)} and {tuple(self.factors.shape)}"
            raise ValueError(f"nodes and factors of {shapes}; must be int64 (M,) and float32 (T, M)")
        if len(self.factors) < 2:
            raise ValueError(f"factors at {len(self.factors)} times; must be two or more")

    def tensors(self) -> dict[str, torch.Tensor]:
        """All numbers, by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def at(self, time: float) -> torch.Tensor:
        """(M,) factors at a time from 0 to 1."""
        first, share = between_steps(time, len(self.factors))
        return torch.lerp(self.factors[first], self.factors[first + 1], share)


def in_light(sh: torch.Tensor, factor: torch.Tensor) -> torch.Tensor:
    """Spherical harmonics (K, 3, M) of nodes whose radiance has a factor (M,).

    The factor is exact for the mean over directions; what depends on direction is scaled as much.
    """
    mean = 0.5 + SH_DC * sh[0]
    radiance = radiance_from_perceptual(mean.clamp(min=0))
    change = perceptual_from_radiance(radiance * factor) / mean.clamp(min=_DARK)
    change = torch.where(radiance > _DARK, change, torch.ones_like(change))
    constant = (mean * change - 0.5) / SH_DC
    return torch.cat([constant[None], sh[1:] * change])
