"""The fitted part of the fusion: a small convolutional network."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from compose.fusion.features import Features


class Fusion(torch.nn.Module):
    """The fitted part: what each parent is worth, from what they show.

    It judges blocks of 2 x 2 pixels, each pixel for itself.
    """

    CHANNELS = 24
    OUTPUTS = 9

    def __init__(self) -> None:
        super().__init__()
        self.reduce = torch.nn.Conv2d(Features.FINE, self.CHANNELS, 2, stride=2)
        self.relate = torch.nn.Conv2d(self.CHANNELS + Features.COARSE, self.CHANNELS, 3, padding=1)
        self.judge = torch.nn.Conv2d(self.CHANNELS, 4 * self.OUTPUTS, 3, padding=1)
        torch.nn.init.zeros_(self.judge.weight)
        assert self.judge.bias is not None
        torch.nn.init.zeros_(self.judge.bias)

    def forward(self, features: Features) -> Tensor:
        """(N, OUTPUTS, H, W)."""
        # Convolutions are quickest with channels last, all else with channels first.
        coarse = features.coarse.contiguous(memory_format=torch.channels_last)
        fine = features.fine.contiguous(memory_format=torch.channels_last)
        hidden = torch.cat([functional.relu(self.reduce(fine)), coarse], 1)
        hidden = functional.relu(self.relate(hidden))
        return functional.pixel_shuffle(self.judge(hidden), 2).contiguous()


def mixture(judged: Tensor, parents: Sequence[Tensor], texture: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Radiance (N, 3, H, W) and weights (N, 3, H, W) that the network's outputs mean."""
    traced, denoised, splat = parents
    weights = torch.softmax(judged[:, 0:3] + judged.new_tensor([-2.0, 0, 0]).view(1, 3, 1, 1), 1)
    gain = 0.5 * torch.tanh(judged[:, 6:9])
    for number, lost in enumerate(texture):
        gain = gain + judged[:, 3 + number : 4 + number] * lost
    sharpened = splat * torch.exp(gain.clamp(-2, 2))
    radiance = weights[:, 0:1] * traced + weights[:, 1:2] * denoised + weights[:, 2:3] * sharpened
    return radiance, weights
