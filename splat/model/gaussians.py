"""The parameters of 3D Gaussians, as a structure of arrays, and the perceptual scale of their colours.

That is the sRGB curve continued above 1, on which a lamp of radiance 50 is only 5.3. 3D Gaussian splatting
trains and stores its colours on it. `Blending` says whether its values or radiance are blended.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import accumulate

import torch

from compose.image.colour import SRGB_DARK, SRGB_DARK_VALUE, SRGB_SLOPE, linear_power, srgb_power

# Factors of the real spherical harmonics, in the order of 3D Gaussian splatting's files.
SH_DC = 0.28209479177387814
SH_LINEAR = 0.4886025119029199
SH_QUADRATIC = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
SH_CUBIC = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)
MAX_DEGREE = 3


def sh_count(degree: int) -> int:
    """Coefficients per channel: (degree + 1)^2."""
    return (degree + 1) ** 2


def as_rows(tensor: torch.Tensor) -> torch.Tensor:
    """(R, N) rows of a tensor (..., N)."""
    return tensor.reshape(math.prod(tensor.shape[:-1]), tensor.shape[-1])


# Names of the tensors that all Gaussians have.
TENSORS = ("means", "log_scales", "rotations", "opacity_logits", "sh")


class Blending(str, Enum):
    """What of Gaussians is blended, by whose rules, under the names in files."""

    # Linear radiance, with the filter of Mip-Splatting: those trained here.
    LINEAR = "linear"
    # Values of the perceptual scale, by the rules of 3D Gaussian splatting (Kerbl et al. 2023); the blended
    # image is made linear radiance afterwards.
    DISPLAY = "display"


@dataclass
class Directional:
    """The spherical harmonics above the constant one, of those of N Gaussians that have any."""

    index: torch.Tensor  # (M,) int64, which Gaussians, ascending
    sh: torch.Tensor  # (K - 1, 3, M) float32, the coefficients of the perceptual radiance

    def __len__(self) -> int:
        return len(self.index)

    def slots(self, count: int) -> torch.Tensor:
        """(N,) int64, of N = `count` Gaussians the position of each one among the M; -1 if it is none."""
        slots = torch.full((count,), -1, dtype=torch.int64, device=self.index.device)
        slots[self.index] = torch.arange(len(self), device=self.index.device)
        return slots

    def select(self, keep: torch.Tensor, count: int) -> Directional:
        """Those of the Gaussians at an index (L,) or a mask of N = `count`."""
        slot = self.slots(count)[keep]
        index = torch.nonzero(slot >= 0)[:, 0]
        return Directional(index, self.sh[..., slot[index]].contiguous())


@dataclass
class Gaussians:
    """N Gaussians.

    All tensors are float32 on one device; any of them may require gradients.

    Attributes:
        means: (3, N) centres in world space, or in the coordinates of a `Place`.
        log_scales: (3, N) natural logarithms of the standard deviations along the principal axes.
        rotations: (4, N) quaternions (w, x, y, z), not necessarily of unit length.
        opacity_logits: (N,) opacity before the sigmoid.
        sh: (K, 3, N) spherical harmonics of the perceptual radiance minus 0.5, K = (degree + 1)^2; with
            `directional` the constant one alone, (1, 3, N).
        directional: the other ones, where only some Gaussians have them; None if all do, or none.
        blending: how they were trained to be blended, and are.

    Raises:
        ValueError: a tensor has the wrong shape.
    """

    means: torch.Tensor
    log_scales: torch.Tensor
    rotations: torch.Tensor
    opacity_logits: torch.Tensor
    sh: torch.Tensor
    directional: Directional | None = field(default=None, kw_only=True)
    blending: Blending = field(default=Blending.LINEAR, kw_only=True)

    def __post_init__(self) -> None:
        n = self.opacity_logits.shape[-1]
        expected = {"means": (3, n), "log_scales": (3, n), "rotations": (4, n), "opacity_logits": (n,)}
        for name, shape in expected.items():
            if tuple(getattr(self, name).shape) != shape:
                raise ValueError(f"{name} has shape {tuple(getattr(self, name).shape)}, expected {shape}")
        k, found = self.sh.shape[0], tuple(self.sh.shape)
        if found != (k, 3, n) or k not in [sh_count(d) for d in range(MAX_DEGREE + 1)]:
            raise ValueError(f"sh has shape {found}, expected (K, 3, {n}) with K in 1, 4, 9, 16")
        if self.directional is None:
            return
        index, further = self.directional.index, self.directional.sh
        known = [sh_count(degree) - 1 for degree in range(MAX_DEGREE + 1)]
        right = k == 1 and further.ndim == 3 and further.shape[0] in known
        if not right or tuple(further.shape[1:]) != (3, len(index)):
            raise ValueError(
                f"directional harmonics of shape {tuple(further.shape)} of {len(index)} Gaussians beside {k} "
                "others, expected (K - 1, 3, M) with K in 1, 4, 9, 16 beside one"
            )
        if index.dtype != torch.int64 or index.ndim != 1:
            raise ValueError("an index of directional harmonics that is not of int64 numbers")
        if len(index) and (int(index[0]) < 0 or int(index[-1]) >= n or bool((index.diff() <= 0).any())):
            raise ValueError(f"directional harmonics of others than {n} Gaussians in ascending order")

    def __len__(self) -> int:
        return self.opacity_logits.shape[0]

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics."""
        further = 0 if self.directional is None else self.directional.sh.shape[0]
        return round((self.sh.shape[0] + further) ** 0.5) - 1

    @property
    def longest(self) -> torch.Tensor:
        """(N,) longest axis, as a standard deviation, without gradient: the 3D size of Fov-GS."""
        return self.log_scales.detach().max(dim=0).values.exp()

    @property
    def turns(self) -> torch.Tensor:
        """(N,) which ones have harmonics above the constant one; all if none are apart."""
        if self.directional is None:
            return torch.ones(len(self), dtype=torch.bool)
        return self.directional.slots(len(self)) >= 0

    def tensors(self) -> Iterator[tuple[str, torch.Tensor]]:
        """Names and tensors of what all Gaussians have, in the order of declaration."""
        for name in TENSORS:
            yield name, getattr(self, name)

    def every_tensor(self) -> list[torch.Tensor]:
        """All tensors, those of `directional` last."""
        further = () if self.directional is None else (self.directional.index, self.directional.sh)
        return [*(tensor for _, tensor in self.tensors()), *further]

    @staticmethod
    def none(degree: int) -> Gaussians:
        """No Gaussians, with spherical harmonics of a degree."""
        rows = [torch.zeros(shape) for shape in ((3, 0), (3, 0), (4, 0), (0,), (sh_count(degree), 3, 0))]
        return Gaussians(*rows)

    def _each(
        self, change: Callable[[torch.Tensor], torch.Tensor], directional: Directional | None
    ) -> Gaussians:
        tensors = [change(tensor) for _, tensor in self.tensors()]
        return Gaussians(*tensors, directional=directional, blending=self.blending)

    def to(self, device: torch.device) -> Gaussians:
        """The same Gaussians on a device; shares the memory of those that are there."""
        further = self.directional
        if further is not None:
            further = Directional(further.index.to(device), further.sh.to(device))
        return self._each(lambda tensor: tensor.to(device), further)

    def select(self, keep: torch.Tensor) -> Gaussians:
        """The Gaussians at an index or a mask (N,), copied."""
        further = None if self.directional is None else self.directional.select(keep, len(self))
        return self._each(lambda tensor: tensor[..., keep].contiguous(), further)

    def part(self, start: int, end: int) -> Gaussians:
        """The Gaussians from start up to end; shares memory."""
        further = self.directional
        if further is not None:
            first, last = torch.searchsorted(further.index, torch.tensor([start, end])).tolist()
            further = Directional(further.index[first:last] - start, further.sh[..., first:last])
        return self._each(lambda tensor: tensor[..., start:end], further)

    def turning(self, kept: torch.Tensor) -> Gaussians:
        """The same Gaussians, of which only those at a mask (N,) keep harmonics above the constant one."""
        if self.directional is not None:
            kept = kept[self.directional.index]
            index, sh = self.directional.index[kept], self.directional.sh[..., kept]
        else:
            # Of degree 0, there is nothing to keep.
            kept = kept if self.degree else torch.zeros_like(kept)
            index, sh = torch.nonzero(kept)[:, 0], self.sh[1:, :, kept]
        return replace(self, sh=self.sh[:1].contiguous(), directional=Directional(index, sh.contiguous()))

    def all_turning(self) -> Gaussians:
        """The same Gaussians with all harmonics in `sh`; those that some did not have are 0."""
        if self.directional is None:
            return self
        further = self.directional.sh
        if len(self.directional) < len(self):
            none = self.sh.new_zeros(len(further), 3, len(self))
            further = none.index_copy(2, self.directional.index, further)
        return replace(self, sh=torch.cat([self.sh, further]), directional=None)

    def replaced(self, index: torch.Tensor, **tensors: torch.Tensor) -> Gaussians:
        """The same Gaussians, of which those at an index (M,) have other tensors (..., M), given by name."""
        whole = {name: getattr(self, name).index_copy(-1, index, part) for name, part in tensors.items()}
        return replace(self, **whole)

    def is_finite(self) -> bool:
        """Whether every number is finite."""
        # An infinity is an extreme and NaN becomes both extremes, so that no tensor of flags is needed.
        extremes = (extreme for t in self.every_tensor() if t.numel() for extreme in torch.aminmax(t))
        return all(bool(torch.isfinite(extreme)) for extreme in extremes)


def concatenated(parts: list[Gaussians]) -> Gaussians:
    """All Gaussians of several sets of the same degree, which are blended alike, in order."""
    further = None
    if any(part.directional is not None for part in parts):
        parts = [apart(part) for part in parts]
        starts = accumulate(map(len, parts), initial=0)
        own = [(start, part.directional) for start, part in zip(starts, parts, strict=False)]
        index = torch.cat([d.index + start for start, d in own if d is not None])
        further = Directional(index, torch.cat([d.sh for _, d in own if d is not None], dim=-1))
    tensors = [torch.cat([getattr(part, name) for part in parts], dim=-1) for name in TENSORS]
    return Gaussians(*tensors, directional=further, blending=parts[0].blending)


def written(gaussians: Gaussians, index: torch.Tensor, part: Gaussians) -> Gaussians:
    """N Gaussians, of which those at an index (M,) are others; `part` has M of the same degree."""
    if gaussians.directional is not None or part.directional is not None:
        former = torch.ones(len(gaussians), dtype=torch.bool).index_fill(0, index, False)
        gaussians, part = apart(gaussians).turning(former), apart(part)
        assert gaussians.directional is not None
        assert part.directional is not None
        which = torch.cat([gaussians.directional.index, index[part.directional.index]])
        sh = torch.cat([gaussians.directional.sh, part.directional.sh], dim=-1)
        order = torch.argsort(which)
        gaussians = replace(gaussians, directional=Directional(which[order], sh[..., order]))
    return gaussians.replaced(index, **dict(part.tensors()))


def apart(gaussians: Gaussians) -> Gaussians:
    """The same Gaussians with harmonics above the constant one apart from it, also if all have them."""
    if gaussians.directional is not None:
        return gaussians
    return gaussians.turning(torch.ones(len(gaussians), dtype=torch.bool))


def perceptual_from_radiance(radiance: torch.Tensor) -> torch.Tensor:
    """The sRGB curve on linear radiance >= 0, continued above 1 by the same power."""
    power = srgb_power(radiance.clamp(min=SRGB_DARK))
    return torch.where(radiance <= SRGB_DARK, SRGB_SLOPE * radiance, power)


def radiance_from_perceptual(value: torch.Tensor) -> torch.Tensor:
    """The inverse of `perceptual_from_radiance`, of values >= 0."""
    power = linear_power(value.clamp(min=SRGB_DARK_VALUE))
    return torch.where(value <= SRGB_DARK_VALUE, value / SRGB_SLOPE, power)
