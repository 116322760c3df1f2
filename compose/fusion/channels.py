"""Named channels of stacked images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Channels:
    """The images of which a stack consists.

    Attributes:
        widths: number of channels of each image by its name, in the order in which they are stacked.
    """

    widths: Mapping[str, int]

    @property
    def total(self) -> int:
        """Number of channels of the stack."""
        return sum(self.widths.values())

    def stacked(self, images: Mapping[str, Tensor]) -> Tensor:
        """(N, total, H, W) stack of named images, each (N, width, H, W).

        Raises:
            ValueError: an image is missing, superfluous, or of another width.
        """
        found = {name: image.shape[-3] for name, image in images.items()}
        if found != self.widths:
            raise ValueError(f"channels are {found}, must be {dict(self.widths)}")
        return torch.cat([images[name] for name in self.widths], -3)

    def parts(self, stack: Tensor) -> dict[str, Tensor]:
        """The named images, each (N, width, H, W), of a stack (N, total, H, W)."""
        return dict(zip(self.widths, stack.split(list(self.widths.values()), -3), strict=True))
