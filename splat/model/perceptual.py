"""Curves from linear radiance to perceptual scales."""

from __future__ import annotations

import torch


def perceptual_from_radiance(radiance: torch.Tensor) -> torch.Tensor:
    """The sRGB curve on linear radiance >= 0, continued above 1 by the same power."""
    power = 1.055 * radiance.clamp(min=0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(radiance <= 0.0031308, 12.92 * radiance, power)


def logarithmic_from_radiance(radiance: torch.Tensor) -> torch.Tensor:
    """The sRGB curve up to 1 and a logarithm of the same slope above, so that lamps do not rule a loss."""
    slope = 1.055 / 2.4
    bright = 1 + slope * torch.log(radiance.clamp(min=1.0))
    return torch.where(radiance > 1.0, bright, perceptual_from_radiance(radiance.clamp(max=1.0)))
