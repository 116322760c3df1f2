"""The fitted part of the fusion: a small convolutional network."""

from __future__ import annotations

import os
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from compose.fusion.channels import Channels
from compose.fusion.features import Features
from compose.fusion.shares import all_of_network

# torch keeps what it has compiled for images of each size, by default a thousand of them at 170 kB each, and
# a disc near the edge of a frame has another size at every gaze. torch reads these limits at the first
# convolution.
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


class Fusion(torch.nn.Module):
    """The network: what each parent is worth, from what all of them show.

    It sees blocks of 2 x 2 pixels, and judges every pixel of them.

    Attributes:
        shares: of its estimate, of the denoised samples and of the splats in what is shown, as of
            `compose.fusion.shares.all_of_network`.
        gains: decibels by which that was better than the better parent on unseen views, for each cell.
    """

    WIDTH = 24  # channels of the hidden layers
    shares: Tensor
    gains: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.reduce = torch.nn.Conv2d(Features.FINE.total, self.WIDTH, 2, stride=2)
        self.relate = torch.nn.Conv2d(self.WIDTH + Features.COARSE.total, self.WIDTH, 3, padding=1)
        self.judge = torch.nn.Conv2d(self.WIDTH, 4 * OUTPUTS.total, 3, padding=1)
        torch.nn.init.zeros_(self.judge.weight)
        assert self.judge.bias is not None
        torch.nn.init.zeros_(self.judge.bias)
        shares = all_of_network()
        self.register_buffer("shares", shares)
        self.register_buffer("gains", torch.zeros(shares.shape[:-1]))

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

    Args:
        judged: (N, OUTPUTS.total, H, W) the network's outputs.
        parents: traced, denoised, splat, each (N, 3, H, W).
        texture: as of Features.
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
