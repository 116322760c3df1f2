"""The features from which the network judges its parents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from compose.fusion.maps import box_mean, enlarged, halved, luminance

# Albedo below this is not told from black: its logarithm would be noise.
_DARK = 0.03
# Least spread of the samples anywhere, in that of the whole picture.
_SPREAD = 0.5


@dataclass(frozen=True)
class Features:
    """What the network looks at, and the texture that it may give the splats.

    Attributes:
        fine: (N, FINE, H, W).
        coarse: (N, COARSE, H / 2, W / 2).
        texture: three of (N, 3, H, W): logarithm of the albedo over its mean in windows of 3, 6 and 12
            pixels, which is what a blur of that size takes from a picture.
    """

    FINE: ClassVar[int] = 10
    COARSE: ClassVar[int] = 21

    fine: Tensor
    coarse: Tensor
    texture: list[Tensor]


def perceived(radiance: Tensor) -> Tensor:
    """About what sRGB makes of radiance up to 1, and slower growth beyond: finite slopes, no upper end.

    Square roots take a tenth of the time of other powers.
    """
    low = torch.sqrt(radiance.clamp(0, 1) + 1e-3)
    return low + 2 * (torch.sqrt(torch.sqrt(radiance.clamp(min=1))) - 1)


def variance_of(moments: Tensor) -> Tensor:
    return (moments[:, 1:2] - moments[:, 0:1] ** 2).clamp(min=0)


def _evidence(traced: Tensor, splat: Tensor) -> list[Tensor]:
    """Whether samples and splats differ by more than noise, at half the resolution.

    Mean of their relative difference, and its t-value, over windows of 6 and of 12 pixels.
    """
    expected = luminance(splat) + 0.05
    ratio = ((luminance(traced) + 0.05) / expected - 1).clamp(-8, 8)
    moments = halved(torch.cat([ratio, ratio**2], 1))
    small, large = box_mean(moments), enlarged(box_mean(halved(moments)), moments)
    # Where no light has been found yet a small window shows no spread; the neighbourhood and the whole
    # picture tell of it.
    everywhere = variance_of(moments) * halved(expected)
    everywhere = everywhere.mean((2, 3), keepdim=True) / expected.mean((2, 3), keepdim=True)
    floor = torch.maximum(variance_of(large), _SPREAD * everywhere)
    found = []
    for mean, pixels in ((small, 36), (large, 144)):
        t = mean[:, 0:1] / torch.sqrt(torch.maximum(variance_of(mean), floor) / pixels + 1e-4)
        found += [mean[:, 0:1].clamp(-1, 1), t / (3 + t.abs())]
    return found


def features_of(images: Sequence[Tensor], count: Tensor, enlargement: Tensor) -> Features:
    """What the network looks at.

    Args:
        images: traced, denoised, splat, albedo, normal, each (N, 3, H, W), both sides even.
        count: (N, 1, H, W) samples.
        enlargement: (N,).
    """
    traced, denoised, splat, albedo, normal = images
    seen_denoised, seen_splat = perceived(denoised), perceived(splat)
    residual = luminance(perceived(traced) - seen_denoised)
    difference = seen_denoised - seen_splat
    logarithm, coarse_albedo = torch.log(albedo + _DARK), halved(albedo)
    means = [box_mean(coarse_albedo), box_mean(halved(coarse_albedo))]
    blurred = [torch.log(mean + _DARK) for mean in (box_mean(albedo), *means)]
    texture = [logarithm - blurred[0], *(logarithm - enlarged(mean, logarithm) for mean in blurred[1:])]
    coarse_logarithm = torch.log(coarse_albedo + _DARK)
    constant = torch.log2(enlargement).clamp(-2, 4).view(-1, 1, 1, 1)
    moments = box_mean(halved(torch.cat([residual, residual**2], 1)))
    coarse = [
        coarse_albedo,
        halved(normal),
        coarse_logarithm - blurred[1],
        coarse_logarithm - enlarged(blurred[2], coarse_logarithm),
        *_evidence(traced, splat),
        moments[:, 0:1],
        torch.log(moments[:, 1:2] + 1e-5) / 4,
        halved(difference.abs().mean(1, keepdim=True)),
        torch.log2(halved(count).clamp(1, 64)) / 3 - 1,
        constant.expand(-1, 1, *coarse_albedo.shape[-2:]),
    ]
    return Features(
        torch.cat([seen_splat, difference, texture[0], residual], 1), torch.cat(coarse, 1), texture
    )
