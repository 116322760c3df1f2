"""Splats and denoised samples fused by statistics alone, for forests to which no network was fitted.

What denoising got wrong cannot be told from the samples that it has seen: where it is as good as the best
filter, its error is orthogonal to what it leaves of them. It does follow a power of what was removed,
though, at all sample counts alike. So the weights are logistic in the logarithms of what is seen, with
coefficients that were fitted once, to many views of several scenes.

All is measured in radiance x relative to its level l, as x / (x + l): that depends on no unit, and an outlier
counts for 1 at most.
"""

from __future__ import annotations

import torch
from torch import Tensor

from compose.fusion.features import texture_of
from compose.fusion.parents import box_mean, enlarged, halved

# Logarithm of the odds of denoised samples against splats, for each channel of `evidence`. With a slight
# penalty on their size, they make the mean of log(0.1 + r) small in 251 discs, where r is the squared error
# of `perceived` radiance as a share of the lesser one of both, without the noise of the references: two views
# each of eight forests of six scenes (three rooms, two groves, and a stage under trusses), with 1 to 32
# samples per pixel, of single frames, of still views and of walks.
ODDS = {"even": 0.23, "removed": -0.63, "apart": 0.89, "along": 1.17, "doublings": 0.56, "quick": -0.37}
_FURTHEST, _MOST_SAMPLES = 3.0, 64.0
# Squared differences below this count as none, and light below this share of the image's mean as dark.
_SAME, _DARK = 1e-5, 0.1
# Share of the texture that the splats seem to lack which they are given.
_CAUTION = 0.7


def statistical(
    traced: Tensor, denoised: Tensor, splat: Tensor, albedo: Tensor, count: Tensor, quick: bool
) -> tuple[Tensor, Tensor]:
    """Radiance and weights (N, 3, H, W) of denoised samples and sharpened splats.

    Images are (N, 3, H, W), counts (N, 1, H, W), quick as in Parents.
    """
    splat, seen = evidence(traced, denoised, splat, albedo, count, quick)
    odds = (seen * seen.new_tensor(list(ODDS.values())).view(1, -1, 1, 1)).sum(1, keepdim=True)
    share = enlarged(torch.sigmoid(odds), splat)
    weights = torch.cat([torch.zeros_like(share), share, 1 - share], 1)
    return torch.lerp(splat, denoised, share), weights


def evidence(
    traced: Tensor, denoised: Tensor, splat: Tensor, albedo: Tensor, count: Tensor, quick: bool
) -> tuple[Tensor, Tensor]:
    """Sharpened splats (N, 3, H, W), and what the odds depend on (N, len(ODDS), H / 4, W / 4).

    The channels are 1; the logarithms of what denoising removed and of how far its result is from the splats,
    both squared; how far the samples lie on the way from these to that; and the doublings of the sample count
    or, since what the quicker denoiser blurs does not become less with the samples, 1 for that. What is seen
    is the mean over about 12 x 12 pixels. Arguments are as in `statistical`.
    """
    level = ((denoised + splat) / 2).mean(1, keepdim=True)
    level = level + _DARK * level.mean((2, 3), keepdim=True) + 1e-30
    splat = sharpened(splat, texture_of(albedo), (traced, denoised), level)
    samples, smooth, biased = (_seen(image, level) for image in (traced, denoised, splat))
    way = smooth - biased
    products = (samples - smooth) ** 2, way**2, (samples - biased) * way
    coarse = halved(torch.cat([*(one.mean(1, keepdim=True) for one in products), count], 1))
    removed, apart, along, number = box_mean(halved(coarse)).split(1, 1)
    doublings = torch.log2(number.clamp(1, _MOST_SAMPLES))
    channels = {
        "even": torch.ones_like(removed),
        "removed": torch.log(removed + _SAME),
        "apart": torch.log(apart + _SAME),
        "along": (along / (apart + _SAME)).clamp(-_FURTHEST, _FURTHEST),
        "doublings": torch.zeros_like(removed) if quick else doublings,
        "quick": torch.full_like(removed, float(quick)),
    }
    return splat, torch.cat([channels[name] for name in ODDS], 1)


def sharpened(splat: Tensor, texture: Tensor, others: tuple[Tensor, Tensor], level: Tensor) -> Tensor:
    """(N, 3, H, W) splats with the texture of the albedo that they lack, as the samples tell.

    One number for the image says how much of it, by least squares; or too much, where they have more than the
    surface. Samples share their noise with the albedo, and denoising copies the albedo's: of both, `others`,
    the lesser one is used, and less than all of it. The level is (N, 1, H, W).
    """
    seen = _seen(splat, level)
    # Around the disc the samples are the splats themselves.
    traced = (others[0] != splat).any(1, keepdim=True)
    # By which each unit of texture changes what is seen of the splats.
    change = torch.where(traced, seen * (1 - seen) * texture, 0)
    found = [
        (change * (_seen(other, level) - seen)).sum((1, 2, 3), keepdim=True)
        / (change**2).sum((1, 2, 3), keepdim=True).clamp(min=_SAME)
        for other in others
    ]
    lacking = _CAUTION * torch.minimum(*found).clamp(-1, 1)
    return splat * torch.exp(lacking * texture)


def _seen(radiance: Tensor, level: Tensor) -> Tensor:
    return radiance / (radiance + level)
