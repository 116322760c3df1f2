"""Radiance that is known up to noise, and errors against it that the noise does not bias."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from compose.fusion.features import perceived, perceived_slope
from compose.fusion.maps import as_batch
from compose.image.colour import Image

# Most that one pixel's noise may count for, in perceived radiance: a single path of a rare kind must not
# outweigh a whole patch. What exceeds it is spread over a window of this many pixels, since the light that
# few paths find would otherwise be missing.
_MOST_NOISE = 1.0
_WINDOW = 33


@dataclass(frozen=True)
class Reference:
    """Noisy radiance of a view from two independent halves of its samples.

    Attributes:
        denoised: (H, W, 3) the same samples, denoised; biased, but near the truth.
        halves: two of (H, W, 3), unbiased.
    """

    denoised: Image
    halves: tuple[Image, Image]

    def targets(self) -> tuple[Tensor, Tensor]:
        """Perceived radiance (3, H, W) by the mean of the halves, and half of their difference.

        An estimate x that is independent of the samples has the squared error (x - target)^2 - noise^2 on
        average, whatever the noise is: it is the product of the errors against either half (Lehtinen et al.
        2018). Perceived radiance is linearized at the denoised radiance, so that noise stays unbiased in it.
        """
        base = as_batch(self.denoised)[0].clamp(min=0)
        seen, slope = perceived(base), perceived_slope(base)
        one, other = (seen + _tamed(slope * (as_batch(half)[0] - base)) for half in self.halves)
        return torch.lerp(one, other, 0.5), (one - other) / 2


def _tamed(noise: Tensor) -> Tensor:
    """Noise (3, H, W) without large values, but with the same local mean."""
    kept = noise.clamp(-_MOST_NOISE, _MOST_NOISE)
    excess = (noise - kept)[None]
    if not bool(excess.any()):
        return kept
    # A row's mean and then a column's is the mean of the window, at a fraction of the time.
    for window in ((_WINDOW, 1), (1, _WINDOW)):
        padding = window[0] // 2, window[1] // 2
        excess = functional.avg_pool2d(excess, window, 1, padding, count_include_pad=False)
    return kept + excess[0]
