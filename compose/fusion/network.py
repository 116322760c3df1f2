"""The fitted part of the fusion: a small convolutional network, its estimate, and how much of it is shown.

The network alone may be worse than the better parent where it has seen too few views or too noisy ones. What
it is worth has therefore been tried on views that it had not seen (compose.fusion.fitting), in cells of
sample count, enlargement and denoiser.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from compose.fusion.features import Features, features_of
from compose.fusion.parents import PARENTS, Channels, Parents

# Cells: samples per pixel, and sides of the splats' pixels in pixels of the image.
COUNTS = (1, 2, 4, 16, 64)
ENLARGEMENTS = (0.5, 1, 2, 4)
# What is mixed, in the order of the shares.
MIXED = ("network", "denoised", "splat")
# Shares are looked up in steps of this fraction of a doubling of the sample count.
_STEPS = 8
# torch keeps what it has compiled for images of each size, by default a thousand at 170 kB each, and a disc
# near a frame's edge has another size at every gaze. It reads these limits at the first convolution.
for _capacity in ("LRU_CACHE_CAPACITY", "ONEDNN_PRIMITIVE_CACHE_CAPACITY"):
    os.environ.setdefault(_capacity, "64")

# What the network says of each pixel, in the order of its weights in files.
OUTPUTS = Channels(
    {
        "weights": 3,  # of traced, denoised and splat, before softmax
        "texture_gains": 3,  # how much of the texture in windows of 3, 6 and 12 pixels the splats lack
        "colour_gains": 3,  # correction of the splats' red, green and blue, before tanh
    }
)
# Before fitting, the noisy samples count for little.
_WEIGHT_OFFSET = (-2.0, 0.0, 0.0)
_MOST_COLOUR_GAIN = 0.5
_MOST_GAIN = 2.0
# Conditions, as an index into shares: whether the denoiser is the quicker one; of COUNTS and ENLARGEMENTS.
Cell = tuple[int, int, int]


def cell_of(quick: bool, count: float, enlargement: float) -> Cell:
    """The cell nearest to some conditions, by ratios of numbers."""
    nearest = lambda values, value: int(np.argmin(np.abs(np.log(values) - math.log(value))))  # noqa: E731
    return int(quick), nearest(COUNTS, max(count, 1e-6)), nearest(ENLARGEMENTS, enlargement)


def shares_at(shares: Tensor, quick: bool, count: Tensor, enlargement: float) -> Tensor:
    """(N, len(MIXED), H, W) shares for each pixel's sample count, interpolated between cells.

    Shares are as in `Fusion`, quick and enlargement as in `Parents`; counts are (N, 1, H, W).
    """
    by_count = _weights(ENLARGEMENTS, enlargement).to(shares.device) @ shares[int(quick)]  # (COUNTS, MIXED)
    table = _steps().to(shares.device) @ by_count
    step = _STEPS * torch.log2(count[:, 0].clamp(min=1))  # (N, H, W)
    step = step.round().clamp(max=len(table) - 1).long()
    return table[step].permute(0, 3, 1, 2).contiguous()


@cache
def _steps() -> Tensor:
    """(steps, len(COUNTS)) weights of the cells at each step of the sample count."""
    last = round(_STEPS * math.log2(COUNTS[-1]))
    return torch.stack([_weights(COUNTS, 2 ** (step / _STEPS)) for step in range(last + 1)])


def _weights(knots: tuple[float, ...], at: float) -> Tensor:
    """(len(knots),) weights that interpolate over the logarithm of knots; constant beyond the ends."""
    weights = [np.interp(math.log(at), np.log(knots), one) for one in np.eye(len(knots))]
    return torch.tensor(weights, dtype=torch.float32)


class Fusion(torch.nn.Module):
    """The network: what each parent is worth, from what all of them show, in blocks of 2 x 2 pixels."""

    WIDTH = 24  # channels of the hidden layers
    shares: Tensor  # (2, len(COUNTS), len(ENLARGEMENTS), len(MIXED)) in what is shown, for each cell
    gains: Tensor  # decibels by which that was better than the better parent on unseen views, for each cell

    def __init__(self) -> None:
        super().__init__()
        self.reduce = torch.nn.Conv2d(Features.FINE.total, self.WIDTH, 2, stride=2)
        self.relate = torch.nn.Conv2d(self.WIDTH + Features.COARSE.total, self.WIDTH, 3, padding=1)
        self.judge = torch.nn.Conv2d(self.WIDTH, 4 * OUTPUTS.total, 3, padding=1)
        torch.nn.init.zeros_(self.judge.weight)
        assert self.judge.bias is not None
        torch.nn.init.zeros_(self.judge.bias)
        gains = torch.zeros(2, len(COUNTS), len(ENLARGEMENTS))
        # Until anything is tried, all is the network's.
        self.register_buffer("shares", torch.stack([gains + 1, gains, gains], -1))
        self.register_buffer("gains", gains)

    def forward(self, features: Features) -> Tensor:
        """(N, OUTPUTS.total, H, W)."""
        # Convolutions are fastest with channels last, everything else with channels first.
        coarse = features.coarse.contiguous(memory_format=torch.channels_last)
        fine = features.fine.contiguous(memory_format=torch.channels_last)
        # (N, WIDTH + COARSE.total, H / 2, W / 2)
        hidden = torch.cat([functional.relu(self.reduce(fine)), coarse], 1)
        hidden = functional.relu(self.relate(hidden))  # (N, WIDTH, H / 2, W / 2)
        return functional.pixel_shuffle(self.judge(hidden), 2).contiguous()


def mixture(judged: Tensor, parents: Sequence[Tensor], texture: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Radiance (N, 3, H, W) and weights (N, 3, H, W) that the network's outputs stand for.

    Outputs are (N, OUTPUTS.total, H, W); parents traced, denoised and splat, (N, 3, H, W) each; texture as in
    Features.
    """
    traced, denoised, splat = parents
    outputs = OUTPUTS.parts(judged)
    offset = judged.new_tensor(_WEIGHT_OFFSET).view(1, 3, 1, 1)
    weights = torch.softmax(outputs["weights"] + offset, 1)
    gain = _MOST_COLOUR_GAIN * torch.tanh(outputs["colour_gains"])
    for share, lost in zip(outputs["texture_gains"].split(1, 1), texture, strict=True):
        gain = gain + share * lost
    sharpened = splat * torch.exp(gain.clamp(-_MOST_GAIN, _MOST_GAIN))
    radiance = weights[:, 0:1] * traced + weights[:, 1:2] * denoised + weights[:, 2:3] * sharpened
    return radiance, weights


def estimated(
    fusion: Fusion, images: Mapping[str, Tensor], parents: Sequence[Parents]
) -> tuple[Tensor, Tensor]:
    """Radiance (N, 3, H, W) by the network alone, and the weights (N, 3, H, W) of the parents in it.

    Images are parents, albedo, normal and count by name, (N, C, H, W) each, both sides even; N parents say
    what is the same in all pixels, enlargement and denoiser.
    """
    three = [images[name] for name in PARENTS]
    enlargement = three[0].new_tensor([float(one.enlargement) for one in parents])
    quick = three[0].new_tensor([float(one.quick) for one in parents])
    features = features_of([*three, images["albedo"], images["normal"]], images["count"], enlargement, quick)
    return mixture(fusion(features), three, features.texture)
