"""The curve from linear radiance to a perceptual scale."""

from __future__ import annotations

import torch


def perceptual_from_radiance(radiance: torch.Tensor) -> torch.Tensor:
    """The sRGB curve on linear radiance >= 0, continued above 1 by the same power."""
    power = 1.055 * radiance.clamp(min=0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(radiance <= 0.0031308, 12.92 * radiance, power)


def radiance_from_perceptual(value: torch.Tensor) -> torch.Tensor:
    """The inverse of `perceptual_from_radiance`, of values >= 0."""
    power = ((value.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(value <= 0.04045, value / 12.92, power)
