"""The features from which the network judges the parents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from compose.fusion.parents import Channels, box_mean, enlarged, halved, luminance, variance_of

# Albedo below this counts as black: its logarithm would be noise.
_DARK = 0.03
# Least variance of the samples anywhere, relative to that of the whole image.
_SPREAD = 0.5


@dataclass(frozen=True)
class Features:
    """What the network sees at full and at half resolution, and texture that it may add to the splats.

    Texture is three of (N, 3, H, W): logarithm of the albedo over its mean in windows of 3, 6 and 12 pixels.
    """

    # The order is that of the network's weights in files.
    FINE: ClassVar[Channels] = Channels(
        {
            "splat": 3,  # perceived radiance
            "difference": 3,  # of denoised samples and splats, perceived
            "texture": 3,  # in windows of 3 pixels
            "residual": 1,  # luminance that denoising removed, perceived
        }
    )
    COARSE: ClassVar[Channels] = Channels(
        {
            "albedo": 3,
            "normal": 3,
            "texture_6": 3,  # in windows of 6 pixels
            "texture_12": 3,  # in windows of 12 pixels
            "ratio_6": 1,  # relative difference of samples and splats, mean over 6 pixels
            "evidence_6": 1,  # its t-value, -1..1
            "ratio_12": 1,  # the same over 12 pixels
            "evidence_12": 1,
            "residual": 1,  # mean over 6 pixels
            "residual_power": 1,  # logarithm of its mean square
            "difference": 1,  # absolute, mean over colours
            "count": 1,  # logarithm of the number of samples
            "enlargement": 1,  # logarithm, the same everywhere
            "quick": 1,  # 1 where the quicker denoiser was used
        }
    )

    fine: Tensor
    coarse: Tensor
    texture: list[Tensor]


def features_of(images: Sequence[Tensor], count: Tensor, enlargement: Tensor, quick: Tensor) -> Features:
    """What the network sees of the parents.

    Images are traced, denoised, splat, albedo and normal, each (N, 3, H, W), both sides even; counts of
    samples (N, 1, H, W); enlargement and quick (N,) as in Parents.
    """
    traced, denoised, splat, albedo, normal = images
    seen_denoised, seen_splat = perceived(denoised), perceived(splat)
    residual = luminance(perceived(traced) - seen_denoised)  # (N, 1, H, W)
    difference = seen_denoised - seen_splat  # (N, 3, H, W)
    texture, coarse_texture = _texture(albedo)
    residual_moments = box_mean(halved(torch.cat([residual, residual**2], 1)))  # (N, 2, H / 2, W / 2)
    coarse_albedo = halved(albedo)
    everywhere = lambda values: values.view(-1, 1, 1, 1).expand(-1, 1, *coarse_albedo.shape[-2:])  # noqa: E731
    fine = {"splat": seen_splat, "difference": difference, "texture": texture[0], "residual": residual}
    coarse = {
        "albedo": coarse_albedo,
        "normal": halved(normal),
        "texture_6": coarse_texture[0],
        "texture_12": coarse_texture[1],
        **_evidence(traced, splat),
        "residual": residual_moments[:, 0:1],
        "residual_power": torch.log(residual_moments[:, 1:2] + 1e-5) / 4,
        "difference": halved(difference.abs().mean(1, keepdim=True)),
        "count": torch.log2(halved(count).clamp(1, 64)) / 3 - 1,
        "enlargement": everywhere(torch.log2(enlargement).clamp(-2, 4)),
        "quick": everywhere(quick),
    }
    return Features(Features.FINE.stacked(fine), Features.COARSE.stacked(coarse), texture)


def perceived(radiance: Tensor) -> Tensor:
    """Roughly sRGB for radiance up to 1, and slower growth beyond: its slope is finite, its range unbounded.

    Square roots take a tenth of the time of other powers.
    """
    low = torch.sqrt(radiance.clamp(0, 1) + 1e-3)
    return low + 2 * (torch.sqrt(torch.sqrt(radiance.clamp(min=1))) - 1)


def perceived_slope(radiance: Tensor) -> Tensor:
    """Derivative of `perceived` at radiance that is not negative."""
    low = 0.5 / torch.sqrt(radiance + 1e-3)
    return torch.where(radiance < 1, low, 0.5 * radiance.clamp(min=1) ** -0.75)


def texture_of(albedo: Tensor) -> Tensor:
    """Logarithm of the albedo (N, 3, H, W) over its means in windows of 3 pixels."""
    return torch.log(albedo + _DARK) - torch.log(box_mean(albedo) + _DARK)


def _texture(albedo: Tensor) -> tuple[list[Tensor], list[Tensor]]:
    """Logarithm of the albedo (N, 3, H, W) over its means in windows of 3, 6 and 12 pixels.

    The last two are repeated at half the resolution, (N, 3, H / 2, W / 2).
    """
    coarse_albedo = halved(albedo)
    means = box_mean(albedo), box_mean(coarse_albedo), box_mean(halved(coarse_albedo))
    blurred = [torch.log(mean + _DARK) for mean in means]  # at full, half and a quarter of the resolution
    fine, coarse = torch.log(albedo + _DARK), torch.log(coarse_albedo + _DARK)
    return (
        [fine - blurred[0], *(fine - enlarged(mean, fine) for mean in blurred[1:])],
        [coarse - blurred[1], coarse - enlarged(blurred[2], coarse)],
    )


def _evidence(traced: Tensor, splat: Tensor) -> dict[str, Tensor]:
    """Whether samples and splats (N, 3, H, W) differ by more than noise, each (N, 1, H / 2, W / 2).

    The mean of their relative difference and its t-value, over windows of 6 and of 12 pixels.
    """
    expected = luminance(splat) + 0.05
    ratio = ((luminance(traced) + 0.05) / expected - 1).clamp(-8, 8)
    moments = halved(torch.cat([ratio, ratio**2], 1))  # (N, 2, H / 2, W / 2)
    small, large = box_mean(moments), enlarged(box_mean(halved(moments)), moments)
    # Where no light has been found yet, a small window shows no variance; its neighbourhood and the image do.
    everywhere = variance_of(moments) * halved(expected)
    everywhere = everywhere.mean((2, 3), keepdim=True) / expected.mean((2, 3), keepdim=True)
    floor = torch.maximum(variance_of(large), _SPREAD * everywhere)
    found = {}
    for mean, side in ((small, 6), (large, 12)):
        t = mean[:, 0:1] / torch.sqrt(torch.maximum(variance_of(mean), floor) / side**2 + 1e-4)
        found[f"ratio_{side}"] = mean[:, 0:1].clamp(-1, 1)
        found[f"evidence_{side}"] = t / (3 + t.abs())
    return found
