"""Estimates of radiance from splats and few samples, and how they are mixed by what the samples tell.

Splats are corrected in two ways. They are sharpened: where the traced albedo varies within the size of a
splat, so must the radiance. And they are relit: what the samples have more or less than the splats varies
slowly, so that its ratio is denoised at half the resolution, in a tenth of the time that denoising all of the
radiance takes, and the splats keep their detail (a ratio estimator, as Heitz et al. 2018 denoise shadows).

All is measured in radiance x relative to its level l, as x / (x + l): that depends on no unit, and an outlier
counts for 1 at most. Images are (N, 3, H, W), levels and counts (N, 1, H, W).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import log

import torch
from torch import Tensor

from compose.fusion.parents import box_mean, enlarged, halved

# Logarithm of the odds of each further estimate against the splats, for each channel of `evidence`, with
# denoised samples and without: by `python -m benchmarks.fit_fusion`.
ODDS = (
    (-1.416, -0.325, -0.086, 0.332, -0.216, 0.172, 0.095, 0.281, -0.384, 1.286),  # relit splats
    (3.069, -0.123, 0.675, 0.115, -0.522, 0.210, 0.605, 0.057, 0.363, -0.274),  # denoised samples
)
QUICK_ODDS = ((5.065, -1.061, 0.582, 0.899, 0.849),)
_FURTHEST, _MOST_SAMPLES = 3.0, 64.0
# Within which the expected error of splats counts.
_LEAST, _MOST = 1e-5, 1e-2
# Squared differences below this count as none, and light below this share of the image's as dark.
_SAME, _DARK = 1e-5, 0.1
# Albedo below this counts as black: its logarithm would be noise.
_BLACK = 0.03
# Share of its texture that the splats seem to lack where they lack none: samples share their noise with the
# albedo.
_SHARED = 0.25
# Of what counts as dark, added to radiance before it is divided; and the largest quotient.
_OFFSET, _MOST_RATIO = 0.5, 100.0


def dark_of(traced: Tensor, splat: Tensor) -> Tensor:
    """(N, 1, 1, 1) radiance that counts as dark: a share of the image's.

    That is the square of its mean root, which few bright samples do not raise.
    """
    return _DARK * torch.sqrt((traced + splat) / 2).mean((1, 2, 3), keepdim=True) ** 2 + 1e-30


def texture_of(albedo: Tensor) -> Tensor:
    """Logarithm of the albedo over its means in windows of 3 pixels."""
    return torch.log(albedo + _BLACK) - torch.log(box_mean(albedo) + _BLACK)


def sharpened(splat: Tensor, texture: Tensor, traced: Tensor, level: Tensor) -> Tensor:
    """Splats with the texture of the albedo that they lack, as the samples tell.

    One number for the image says how much of it, by least squares.
    """
    seen = _seen(splat, level)
    # Around the disc the samples are the splats themselves.
    known = (traced != splat).any(1, keepdim=True)
    # By which each unit of texture changes what is seen of the splats.
    change = torch.where(known, seen * (1 - seen) * texture, 0)
    found = (change * (_seen(traced, level) - seen)).sum((1, 2, 3), keepdim=True)
    found = found / (change**2).sum((1, 2, 3), keepdim=True).clamp(min=_SAME)
    return splat * torch.exp((found - _SHARED).clamp(0, 1) * texture)


def ratio_of(traced: Tensor, splat: Tensor, dark: Tensor) -> Tensor:
    """(N, 3, H / 2, W / 2) how much more light samples have than splats; sides even, dark (N, 1, 1, 1)."""
    # Where both are dark, it would be noise.
    offset = _OFFSET * dark
    return ((halved(traced) + offset) / (halved(splat) + offset)).clamp(max=_MOST_RATIO)


def relit(splat: Tensor, ratio: Tensor, dark: Tensor) -> Tensor:
    """Splats times a denoised `ratio`."""
    offset = _OFFSET * dark
    return (enlarged(ratio, splat) * (splat + offset) - offset).clamp(min=0)


def shares(seen: Tensor, like: Tensor) -> Tensor:
    """(N, 2 or 3, H, W) weights of the candidates in a mixture by what is seen of them (`evidence`).

    They are logistic in the logarithms of what is seen: what a filter got wrong cannot be told from the
    samples that it has seen, but follows a power of what it removed, at all sample counts alike.
    """
    odds = seen.new_tensor(QUICK_ODDS if seen.shape[1] == len(QUICK_ODDS[0]) else ODDS)
    logits = torch.einsum("kc,nchw->nkhw", odds, seen)
    weights = torch.softmax(torch.cat([torch.zeros_like(logits[:, :1]), logits], 1), 1)
    return enlarged(weights, like)


def evidence(
    candidates: Sequence[Tensor], images: Mapping[str, Tensor], level: Tensor, expected: float
) -> Tensor:
    """What the odds of an estimate against the splats depend on, (N, 5 or 10, H / 4, W / 4).

    Candidates are splats, relit splats and, if there are any, denoised samples; images and what is expected
    are those of Parents. The channels are 1; the logarithms of what relit splats lack of the samples and of
    how far they are from the splats, both squared; and how far the samples lie on the way from the splats to
    them. Then, the logarithm of what is expected; or with denoised samples, the three of these, the last one
    from halfway and times the doublings of the sample count, with which it is known better; how far these are
    from relit splats, and the samples on the way there; and the share of samples of earlier views: denoising
    takes what these have in common for what there is. What is seen is the mean over about 12 x 12 pixels.
    """
    samples, first, second, *third = (_seen(image, level) for image in (images["traced"], *candidates))
    products = _products(samples, first, second)
    for denoised in third:
        products += _products(samples, first, denoised) + _products(samples, second, denoised)[1:]
    maps = [part.mean(1, keepdim=True) for part in products]
    if third:
        maps += [images["count"], images["earlier"]]
    means = box_mean(halved(halved(torch.cat(maps, 1)))).split(1, 1)
    even = torch.ones_like(means[0])
    channels = [even, torch.log(means[0] + _SAME), *_way(*means[1:3])]
    if third:
        number, earlier = means[-2:]
        apart, along = _way(*means[4:6])
        doublings = torch.log2(number.clamp(1, _MOST_SAMPLES))
        channels += [torch.log(means[3] + _SAME), apart, (along - 0.5) * doublings, *_way(*means[6:8])]
        channels.append((earlier / number.clamp(min=1)).clamp(max=1))
    else:
        channels.append(even * log(min(max(expected, _LEAST), _MOST)))
    return torch.cat(channels, 1)


def _products(samples: Tensor, one: Tensor, other: Tensor) -> list[Tensor]:
    """What another estimate lacks of the samples and how far it is from one, squared, and their product."""
    way = other - one
    return [(samples - other) ** 2, way**2, (samples - one) * way]


def _way(apart: Tensor, along: Tensor) -> tuple[Tensor, Tensor]:
    return torch.log(apart + _SAME), (along / (apart + _SAME)).clamp(-_FURTHEST, _FURTHEST)


def _seen(radiance: Tensor, level: Tensor) -> Tensor:
    return radiance / (radiance + level)
