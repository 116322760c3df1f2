"""How much of the network's estimate, of the denoised samples and of the splats a fusion shows.

The network alone may be worse than the better parent, where it has seen too few views or too noisy ones. What
it is worth has therefore been tried on views that it had not seen (compose.fusion.proof), in cells of sample
count, enlargement and denoiser.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

# Cells: samples per pixel, and sides of the splats' pixels in pixels of the image.
COUNTS = (1, 2, 4, 16, 64)
ENLARGEMENTS = (0.5, 1, 2, 4)
# What is mixed, in the order of the shares.
MIXED = ("network", "denoised", "splat")
# Shares are looked up in steps of this fraction of a doubling of the sample count.
_STEPS = 8


@dataclass(frozen=True)
class Cell:
    """Conditions under which a share was tried.

    Attributes:
        quick: whether the quicker denoiser was used.
        count: index of COUNTS.
        enlargement: index of ENLARGEMENTS.
    """

    quick: bool
    count: int
    enlargement: int

    @staticmethod
    def of(quick: bool, count: float, enlargement: float) -> Cell:
        """The cell nearest to some conditions."""
        nearest = lambda values, value: min(  # noqa: E731
            range(len(values)), key=lambda index: abs(math.log(values[index] / value))
        )
        return Cell(quick, nearest(COUNTS, max(count, 1e-6)), nearest(ENLARGEMENTS, enlargement))

    @property
    def index(self) -> tuple[int, int, int]:
        """Of a tensor of shares."""
        return int(self.quick), self.count, self.enlargement


def all_of_network() -> Tensor:
    """(2, len(COUNTS), len(ENLARGEMENTS), len(MIXED)) shares of a network that nothing is known about."""
    shares = torch.zeros(2, len(COUNTS), len(ENLARGEMENTS), len(MIXED))
    shares[..., 0] = 1
    return shares


def shares_at(shares: Tensor, quick: bool, count: Tensor, enlargement: float) -> Tensor:
    """(N, len(MIXED), H, W) shares for each pixel's sample count, interpolated between cells.

    Args:
        shares: as of `all_of_network`.
        quick: whether the quicker denoiser was used.
        count: (N, 1, H, W) samples.
        enlargement: side of the splats' pixels in pixels of the image.
    """
    by_count = _weights(ENLARGEMENTS, enlargement).to(shares.device) @ shares[int(quick)]  # (COUNTS, MIXED)
    table = _steps().to(shares.device) @ by_count
    last = len(table) - 1
    step = (_STEPS * torch.log2(count[:, 0].clamp(min=1))).round().clamp(max=last).long()  # (N, H, W)
    return table[step].permute(0, 3, 1, 2).contiguous()


@cache
def _steps() -> Tensor:
    """(steps, len(COUNTS)) weights of the cells at each step of the sample count."""
    last = round(_STEPS * math.log2(COUNTS[-1]))
    return torch.stack([_weights(COUNTS, 2 ** (step / _STEPS)) for step in range(last + 1)])


def _weights(knots: tuple[float, ...], at: float) -> Tensor:
    """(len(knots),) weights that interpolate over the logarithm of knots; constant beyond the ends."""
    weights = torch.zeros(len(knots))
    at = min(max(at, knots[0]), knots[-1])
    upper = next(index for index, knot in enumerate(knots) if knot >= at)
    way = 1.0
    if upper > 0:
        way = math.log(at / knots[upper - 1]) / math.log(knots[upper] / knots[upper - 1])
        weights[upper - 1] = 1 - way
    weights[upper] = way
    return weights
