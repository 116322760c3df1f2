"""The loss in plain torch, float64: the twin of its kernels."""

from __future__ import annotations

import torch

from splat.model.gaussians import perceptual_from_radiance
from splat.training.loss import SSIM_WEIGHT, WEIGHTS


def blurred(maps: torch.Tensor) -> torch.Tensor:
    """The window over maps (C, H, W), valid region."""
    weights = torch.tensor(WEIGHTS, dtype=maps.dtype)
    window = torch.outer(weights, weights)[None, None]
    return torch.nn.functional.conv2d(maps[:, None], window)[:, 0]


def ssim(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Mean structural similarity of two images (H, W, 3) (Wang et al. 2004)."""
    zero = b.mean(dim=(0, 1)).reshape(3, 1, 1)
    a, b = a.permute(2, 0, 1) - zero, b.permute(2, 0, 1) - zero
    mean, own_mean = blurred(a), blurred(b)
    variance, own_variance = blurred(a * a) - mean**2, blurred(b * b) - own_mean**2
    covariance = blurred(a * b) - mean * own_mean
    level, own_level = mean + zero, own_mean + zero
    numerator = (2 * level * own_level + 0.01**2) * (2 * covariance + 0.03**2)
    return (numerator / ((level**2 + own_level**2 + 0.01**2) * (variance + own_variance + 0.03**2))).mean()


def logarithmic(radiance: torch.Tensor) -> torch.Tensor:
    """The sRGB curve up to 1 and a logarithm of the same slope above, so that lamps do not rule a loss."""
    slope = 1.055 / 2.4
    bright = 1 + slope * torch.log(radiance.clamp(min=1.0))
    return torch.where(radiance > 1.0, bright, perceptual_from_radiance(radiance.clamp(max=1.0)))


def loss(rendered: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """The training loss of an image (H, W, 3), float64, against another."""
    a, b = logarithmic(rendered), logarithmic(target)
    return (1 - SSIM_WEIGHT) * (a - b).abs().mean() + SSIM_WEIGHT * (1 - ssim(a, b))
