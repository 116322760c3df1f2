"""The parameters of 3D Gaussians, as a structure of arrays.

Radiance is linear and unbounded. The spherical harmonics represent it on a perceptual scale, the sRGB curve
continued above 1: on this scale 3D Gaussian splatting trains, its files store colours, and a lamp of
radiance 50 is only 5.3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import torch

# Factors of the real spherical harmonics, in the order of 3D Gaussian splatting's files.
SH_DC = 0.28209479177387814
SH_LINEAR = 0.4886025119029199
SH_QUADRATIC = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
SH_CUBIC = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)
MAX_DEGREE = 3


def sh_count(degree: int) -> int:
    """Coefficients per channel: (degree + 1)^2."""
    return (degree + 1) ** 2


@dataclass
class Gaussians:
    """N Gaussians.

    All tensors are float32 on one device; any of them may require gradients.

    Attributes:
        means: (3, N) centres in world space, or in the coordinates of a `Place`.
        log_scales: (3, N) natural logarithms of the standard deviations along the principal axes.
        rotations: (4, N) quaternions (w, x, y, z), not necessarily of unit length.
        opacity_logits: (N,) opacity before the sigmoid.
        sh: (K, 3, N) spherical harmonics of the perceptual radiance minus 0.5, K = (degree + 1)^2.

    Raises:
        ValueError: a tensor has the wrong shape.
    """

    means: torch.Tensor
    log_scales: torch.Tensor
    rotations: torch.Tensor
    opacity_logits: torch.Tensor
    sh: torch.Tensor

    def __post_init__(self) -> None:
        n = self.opacity_logits.shape[-1]
        expected = {"means": (3, n), "log_scales": (3, n), "rotations": (4, n), "opacity_logits": (n,)}
        for name, shape in expected.items():
            if tuple(getattr(self, name).shape) != shape:
                raise ValueError(f"{name} has shape {tuple(getattr(self, name).shape)}, expected {shape}")
        k = self.sh.shape[0]
        if tuple(self.sh.shape) != (k, 3, n) or k not in [sh_count(d) for d in range(MAX_DEGREE + 1)]:
            raise ValueError(
                f"sh has shape {tuple(self.sh.shape)}, expected (K, 3, {n}) with K in 1, 4, 9, 16"
            )

    def __len__(self) -> int:
        return self.opacity_logits.shape[0]

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics."""
        return round(self.sh.shape[0] ** 0.5) - 1

    def tensors(self) -> Iterator[tuple[str, torch.Tensor]]:
        """Names and tensors, in the order of declaration."""
        for field in fields(self):
            yield field.name, getattr(self, field.name)

    @staticmethod
    def none(degree: int) -> Gaussians:
        """No Gaussians, with spherical harmonics of a degree."""
        rows = [torch.zeros(shape) for shape in ((3, 0), (3, 0), (4, 0), (0,), (sh_count(degree), 3, 0))]
        return Gaussians(*rows)

    def select(self, keep: torch.Tensor) -> Gaussians:
        """The Gaussians at an index or a mask (N,), copied."""
        return Gaussians(**{name: tensor[..., keep].contiguous() for name, tensor in self.tensors()})

    def is_finite(self) -> bool:
        """Whether every number is finite."""
        # An infinity is an extreme and NaN becomes both extremes, so that no tensor of flags is needed.
        return all(
            bool(torch.isfinite(extreme))
            for _, t in self.tensors()
            if t.numel()
            for extreme in torch.aminmax(t)
        )


def concatenated(parts: list[Gaussians]) -> Gaussians:
    """All Gaussians of several sets of the same degree, in order."""
    names = [name for name, _ in parts[0].tensors()]
    return Gaussians(**{name: torch.cat([getattr(p, name) for p in parts], dim=-1) for name in names})
