"""What is fused, and the result; as batches of images (N, C, H, W): small filters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from compose.image.colour import LUMINANCE_WEIGHTS, Image

# What an estimate is made of, in the order of its weights.
PARENTS = ("traced", "denoised", "relit", "splat")
# Squared error of sRGB values, from 0 to 1, of splats of which nothing is known: that of a forest of 35 dB.
TYPICAL_ERROR = 3e-4


@dataclass(frozen=True)
class Parents:
    """Images of one view from which its radiance is estimated, all of NumPy or all of torch on one device.

    ValueError if the shapes do not match.

    Attributes:
        expected: squared error of sRGB values, from 0 to 1, that is typical of the splats.
    """

    traced: Image | Tensor  # (H, W, 3) mean of the path-traced samples, linear radiance
    variance: Image | Tensor  # (H, W, 3) of that mean; inf where it is unknown
    splat: Image | Tensor  # (H, W, 3) the splats, rendered for the same view
    albedo: Image | Tensor  # (H, W, 3) of the same samples
    count: Image | Tensor  # (H, W, 1) number of samples
    earlier: Image | Tensor  # (H, W, 1) how many of these were reprojected from earlier views
    denoised: Image | Tensor | None = None  # (H, W, 3) the same samples, denoised, unless that takes too long
    expected: float = TYPICAL_ERROR

    def __post_init__(self) -> None:
        for name, image in self.images().items():
            shape = tuple(image.shape)
            expected = (*self.traced.shape[:2], 1 if name in ("count", "earlier") else 3)
            if shape != expected:
                raise ValueError(f"{name} is {shape}, must be {expected} to match traced")

    def images(self) -> dict[str, Image | Tensor]:
        """All images that there are, by name."""
        return {name: of for name, of in vars(self).items() if isinstance(of, np.ndarray | Tensor)}


@dataclass(frozen=True)
class Fused:
    """One estimate of radiance (H, W, 3), of torch on the parents' device, and weights (H, W, len(PARENTS)).

    In `excluded` pixels a parent was left out because it was negative, not finite, or out of proportion to
    its neighbours and to the other parents (compose.image.colour).
    """

    radiance: Tensor
    weights: Tensor
    excluded: int


def box_mean(image: Tensor) -> Tensor:
    """Mean over windows of 3 x 3 pixels, with borders repeated."""
    image = functional.pad(image, (1, 1, 1, 1), mode="replicate")
    # On the CPU, pooling takes seven times as long as sums; on a card it is one launch of many.
    if image.is_cuda:
        return functional.avg_pool2d(image, 3, 1)
    image = image[..., :-2] + image[..., 1:-1] + image[..., 2:]
    return (image[..., :-2, :] + image[..., 1:-1, :] + image[..., 2:, :]) / 9


def halved(image: Tensor) -> Tensor:
    """Means over blocks of 2 x 2 pixels, over fewer at odd ends."""
    # For even sides, pooling takes three times as long on the CPU.
    if image.shape[-1] % 2 or image.shape[-2] % 2 or image.is_cuda:
        return functional.avg_pool2d(image, 2, ceil_mode=True)
    above, below = image[..., ::2, :], image[..., 1::2, :]
    return 0.25 * (above[..., ::2] + below[..., ::2] + above[..., 1::2] + below[..., 1::2])


def enlarged(image: Tensor, like: Tensor) -> Tensor:
    """An image interpolated bilinearly to the height and width of another one."""
    return functional.interpolate(image, size=like.shape[-2:], mode="bilinear")


def luminance(image: Tensor) -> Tensor:
    """(N, 1, H, W) luminance of linear radiance (N, 3, H, W)."""
    red, green, blue = LUMINANCE_WEIGHTS
    return red * image[:, 0:1] + green * image[:, 1:2] + blue * image[:, 2:3]


def variance_of(moments: Tensor) -> Tensor:
    """(N, 1, H, W) variance from means of a value and of its square (N, 2 or more, H, W)."""
    return (moments[:, 1:2] - moments[:, 0:1] ** 2).clamp(min=0)


def as_batch(image: Image | Tensor) -> Tensor:
    """(1, C, H, W) from an image (H, W, C), of NumPy or of torch on any device."""
    if not isinstance(image, Tensor):
        image = torch.from_numpy(np.ascontiguousarray(image, dtype=np.float32))
    return image.permute(2, 0, 1).contiguous()[None]


def padded_to_even(image: Tensor) -> Tensor:
    """The image with its last row or column repeated where their number is odd."""
    height, width = image.shape[-2:]
    if not (height % 2 or width % 2):
        return image
    return functional.pad(image, (0, width % 2, 0, height % 2), mode="replicate")
