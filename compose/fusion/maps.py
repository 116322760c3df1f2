"""Small filters on batches of images (N, C, H, W)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from compose.image.colour import LUMINANCE_WEIGHTS, Image


def box_mean(image: Tensor) -> Tensor:
    """Mean over windows of 3 x 3 pixels, with borders repeated; pooling takes seven times as long."""
    image = functional.pad(image, (1, 1, 1, 1), mode="replicate")
    image = image[..., :-2] + image[..., 1:-1] + image[..., 2:]
    return (image[..., :-2, :] + image[..., 1:-1, :] + image[..., 2:, :]) / 9


def halved(image: Tensor) -> Tensor:
    """Means over blocks of 2 x 2 pixels, over fewer at odd ends."""
    if image.shape[-1] % 2 or image.shape[-2] % 2:
        return functional.avg_pool2d(image, 2, ceil_mode=True)
    # For even sides, pooling takes three times as long.
    return 0.25 * (
        image[..., ::2, ::2] + image[..., 1::2, ::2] + image[..., ::2, 1::2] + image[..., 1::2, 1::2]
    )


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
