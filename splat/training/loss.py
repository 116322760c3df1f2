"""The training loss, with the structural similarity in it."""

from __future__ import annotations

from functools import lru_cache

import torch

from splat.model.perceptual import logarithmic_from_radiance

_WINDOW = 11
_SIGMA = 1.5
# Smaller images do not hold the similarity's window.
SMALLEST_SIDE = _WINDOW
_C1, _C2 = 0.01**2, 0.03**2
SSIM_WEIGHT = 0.2


@lru_cache(maxsize=8)
def _blur_matrix(size: int) -> torch.Tensor:
    """(size - 10, size) band matrix that applies a Gaussian window of 11 taps over the valid region."""
    offset = torch.arange(_WINDOW, dtype=torch.float32) - _WINDOW // 2
    weights = torch.exp(-(offset**2) / (2 * _SIGMA**2))
    matrix = torch.zeros(size - _WINDOW + 1, size)
    for tap, weight in enumerate(weights / weights.sum()):
        matrix.diagonal(tap).fill_(weight)
    return matrix


def _blur(maps: torch.Tensor) -> torch.Tensor:
    """Applies the window to maps (C, H, W); returns (C, H - 10, W - 10).

    The separable window is two matrix products: on two cores torch's convolution with the same window takes
    70 ms forward and 165 ms backward for 256 x 256 pixels, the products a tenth of that.
    """
    rows, columns = _blur_matrix(maps.shape[1]).to(maps), _blur_matrix(maps.shape[2]).to(maps)
    return rows @ (maps @ columns.T)


class Target:
    """A frame to match, with the terms of the similarity that depend on it alone.

    Args:
        radiance: (H, W, 3) linear, both sides at least 11 pixels.

    Attributes:
        seen: (H, W, 3) the frame on the loss's scale.
        mean, variance: (3, H - 10, W - 10) of each window.
    """

    def __init__(self, radiance: torch.Tensor):
        self.seen = logarithmic_from_radiance(radiance)
        planes = self.seen.permute(2, 0, 1)
        # Variances do not depend on where zero is. With zero amid the frame's own values, little cancels in
        # them; where all is very bright, rounding would otherwise exceed the similarity's constants.
        self._zero = planes.mean(dim=(1, 2), keepdim=True)
        self._planes = planes - self._zero
        self.mean, square = _blur(torch.cat([self._planes, self._planes * self._planes])).split(3)
        self.variance = square - self.mean**2
        self._level = self.mean + self._zero

    def loss(self, rendered: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(1 - w) L1 + w (1 - SSIM), on a scale for lamps beside shadows (Fov-GS Eq. 4).

        Args:
            rendered: (H, W, 3) linear radiance.

        Returns:
            The loss, and the absolute error per pixel (H, W), which has no gradient.
        """
        seen = logarithmic_from_radiance(rendered)
        difference = (seen - self.seen).abs()
        loss = (1 - SSIM_WEIGHT) * difference.mean() + SSIM_WEIGHT * (1 - self.ssim(seen))
        return loss, difference.detach().mean(dim=-1)

    def ssim(self, seen: torch.Tensor) -> torch.Tensor:
        """Mean structural similarity with an image (H, W, 3) on the loss's scale (Wang et al. 2004)."""
        a, b = seen.permute(2, 0, 1) - self._zero, self._planes
        mean, square, product = _blur(torch.cat([a, a * a, a * b])).split(3)
        covariance, variance = product - mean * self.mean, square - mean**2
        level = mean + self._zero
        numerator = (2 * level * self._level + _C1) * (2 * covariance + _C2)
        denominator = (level**2 + self._level**2 + _C1) * (variance + self.variance + _C2)
        return (numerator / denominator).mean()
