"""One estimate of foveal radiance from noisy samples, denoised samples, and biased splats.

The traced radiance is noisy, denoising blurs and invents, splats lack detail and cannot follow changes. A
small convolutional network, fitted to a scene, sees all of them and says per pixel what each is worth; where
none was fitted, statistics do (`statistical`). Five things are built around it:

- The splats are sharpened first: where the traced albedo varies within the size of a splat, so must the
  radiance. How much of that variation they lack is part of what the network says.
- What the network says is mixed with the denoised samples and the splats in shares that were tried on views
  it had not seen; where it did not prove itself there, the better parent alone is shown.
- Where there are many samples, they tell whether the denoised ones are nearer to the truth than the estimate
  of the network, which has never seen so many.
- The result is drawn towards the traced radiance wherever the two differ by more than noise explains, in
  the spirit of the James-Stein combiner of Gu et al. 2022: with more samples the weight of these goes to 1.
- A parent that is negative, not finite or out of all proportion in a pixel is replaced by another one there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from compose.fusion.features import texture_of
from compose.fusion.network import Fusion, estimated, shares_at
from compose.fusion.parents import (
    IMAGES,
    PARENTS,
    Fused,
    Parents,
    as_batch,
    box_mean,
    enlarged,
    halved,
    luminance,
    padded_to_even,
    variance_of,
)
from compose.image.colour import MOST, outliers

# Relative bias that no estimate but the traced radiance is trusted to stay below.
_FLOOR = 0.005
# How much wider than a normal distribution's the confidence interval around a few samples' bias may be.
_TAILS = 20.0
# From this number of samples per pixel on they can tell whether the denoised ones are nearer to the truth
# than the network's estimate; and how strongly their noise speaks against that.
_TELLING_COUNT = 32
_CAUTION = 24.0
# Splats to which the network gives less weight than this show a scene that has changed since their training.
_TRUSTED = 0.2
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
_LACKING = 0.7


def fuse(parents: Parents, fusion: Fusion | None) -> Fused:
    """One estimate from all parents of a view, by a fusion fitted to its scene; without one by statistics."""
    height, width = parents.traced.shape[:2]
    with torch.inference_mode():
        images = {name: as_batch(getattr(parents, name)) for name in IMAGES}
        # The least and the largest radiance of the parents, whether features are finite, and the mean count:
        # together, since a card is waited for. A number that is none is the least and the largest one, too.
        ends = torch.aminmax(torch.cat([images[name] for name in PARENTS]))
        known = torch.isfinite(images["albedo"] + images["normal"]).all().to(ends.min.dtype)
        least, most, finite, mean_count = torch.stack([*ends, known, images["count"].mean()]).tolist()
        plain, excluded = least >= 0 and most <= MOST and finite == 1, 0
        if not plain:
            images, excluded = _usable(images)
        # (1, C, H, W) each; the network sees blocks of 2 x 2.
        images = {name: padded_to_even(image) for name, image in images.items()}
        traced, denoised, variance, count = (images[n] for n in ("traced", "denoised", "variance", "count"))
        radiance, weights = _first_estimate(images, parents, fusion)
        if mean_count >= _TELLING_COUNT:
            share = regressed(radiance, denoised, traced, variance, plain)
            radiance, weights = torch.lerp(radiance, denoised, share), weights * (1 - share)
            weights[:, 1:2] += share  # denoised
        share = trust(radiance, traced, variance, count, plain)
        radiance = torch.lerp(traced, radiance, share)
        weights = weights * share
        weights[:, 0:1] += 1 - share  # traced
    radiance, weights = (of[0, :, :height, :width].permute(1, 2, 0) for of in (radiance, weights))
    return Fused(radiance, weights, excluded)


def _first_estimate(
    images: Mapping[str, Tensor], parents: Parents, fusion: Fusion | None
) -> tuple[Tensor, Tensor]:
    """Radiance and weights (1, 3, H, W) by the network, or without one by statistics."""
    traced, denoised, splat = (images[name] for name in PARENTS)
    if fusion is None:
        return statistical(traced, denoised, splat, images["albedo"], images["count"], parents.quick)
    shares = shares_at(fusion.shares, parents.quick, images["count"], parents.enlargement)
    network, denoised_share, splat_share = shares.split(1, 1)  # (1, 1, H, W) each
    if not bool((network + splat_share).any()):
        return denoised, torch.cat([network, denoised_share, splat_share], 1)
    estimate, of_estimate = estimated(fusion, images, [parents])
    # What the network sees to be of another world is not shown beside its estimate either. Cubed, so that the
    # splats have mostly given way before the network lets go of them entirely.
    doubted = splat_share * (1 - (of_estimate[:, 2:3] / _TRUSTED).clamp(max=1) ** 3)
    network, splat_share = network + doubted, splat_share - doubted
    radiance = network * estimate + denoised_share * denoised + splat_share * splat
    weights = torch.cat([torch.zeros_like(network), denoised_share, splat_share], 1)
    return radiance, weights + network * of_estimate


def regressed(
    estimate: Tensor, other: Tensor, traced: Tensor, variance: Tensor, plain: bool = False
) -> Tensor:
    """(N, 1, H, W) how far the traced radiance lies along the way from an estimate to another one, 0..1.

    It is found by least squares over about 6 x 6 pixels. A multiple of the variance of their mean is added to
    the squared length of the way: where the two estimates differ by less than noise, the first one is kept.
    All images are (N, 3, H, W).
    """
    estimate, other, traced = _squarable(plain, estimate, other, traced)
    known = torch.isfinite(variance).all(1, keepdim=True)
    noise = torch.where(known, variance, 0).to(traced.dtype).mean(1, keepdim=True)
    way = other - estimate  # (N, 3, H, W)
    along = ((traced - estimate) * way).mean(1, keepdim=True)
    maps = box_mean(halved(torch.cat([along, (way**2).mean(1, keepdim=True), noise], 1)))
    share = maps[:, 0:1] / (maps[:, 1:2] + _CAUTION * maps[:, 2:3] / 36 + 1e-12)
    return torch.where(known, enlarged(share.clamp(0, 1), traced), 0.0).to(variance.dtype)


def trust(estimate: Tensor, traced: Tensor, variance: Tensor, count: Tensor, plain: bool = False) -> Tensor:
    """(N, 1, H, W) share that an estimate of unknown bias keeps beside the unbiased one, 0..1.

    v / (v + b^2) is the best share for independent errors of variance v and bias b. The squared bias is
    estimated over about 6 x 6 pixels and taken at the lower end of its confidence interval (two standard
    errors): noise must not count as bias. Where few samples have found light yet, both their mean and their
    variance are too small, so the relative variance of the neighbourhood counts where it is larger; and the
    fewer the samples, the wider the interval may be. Images are (N, 3, H, W), counts (N, 1, H, W).
    """
    estimate, traced = _squarable(plain, estimate, traced)
    known = torch.isfinite(variance).all(1, keepdim=True)
    explained = torch.where(known, variance, 0).to(traced.dtype).mean(1, keepdim=True)
    excess = ((estimate - traced) ** 2).mean(1, keepdim=True) - explained
    level = luminance(estimate) ** 2 + 1e-8
    maps = halved(torch.cat([excess, excess**2, explained, level], 1))
    small, large = box_mean(maps), enlarged(box_mean(halved(halved(maps))), maps)
    level = small[:, 3:4]
    explained = torch.maximum(small[:, 2:3], large[:, 2:3] / large[:, 3:4] * level)
    error = torch.sqrt(torch.maximum(variance_of(small), variance_of(large)) / 36)
    error = torch.minimum(error, explained * (1.5 + _TAILS / torch.sqrt(halved(count))))
    bias = torch.maximum(small[:, 0:1] - 2 * error, _FLOOR**2 * level)
    share = explained / (explained + bias + 1e-20)
    return torch.where(known, enlarged(share, traced), 1.0).to(variance.dtype)


def _squarable(plain: bool, *images: Tensor) -> tuple[Tensor, ...]:
    """Images of radiance in a type that holds their fourth powers: float32 ends at those of 4e9.

    They are looked at, which waits for a card, unless they are `plain`: made of parents of at most MOST.
    """
    if plain:
        return images
    ends = [end for image in images for end in torch.aminmax(image)]
    wide = max(abs(float(end)) for end in ends) > MOST
    return tuple(image.double() for image in images) if wide else images


def _usable(images: dict[str, Tensor]) -> tuple[dict[str, Tensor], int]:
    """The parents with whatever cannot be radiance replaced, and in how many pixels; see `Fused`."""
    radiance = torch.cat([images[name] for name in PARENTS])
    traced, denoised, splat = (image.permute(1, 2, 0).cpu().numpy() for image in radiance)
    # (H, W, 1) each. Where splats and denoised samples are wrong, they are so in whole patches.
    no_traced = outliers(traced, splat)
    samples = np.where(no_traced, 0, traced)
    no_splat = outliers(splat, samples, beside=False)
    no_denoised = outliers(denoised, samples, np.where(no_splat, 0, splat), beside=False)
    # Denoising has used the neighbouring pixels, so its result is the first substitute for the others.
    denoised = np.where(no_denoised, np.where(no_splat, 0, splat), denoised)
    replaced = {
        "traced": np.where(no_traced, denoised, traced),
        "denoised": denoised,
        "splat": np.where(no_splat, denoised, splat),
    }
    device = radiance.device
    auxiliary = {n: torch.nan_to_num(images[n], posinf=0, neginf=0) for n in ("albedo", "normal")}
    unknown = as_batch(no_traced.astype(np.float32)).bool().to(device)
    variance = images["variance"].masked_fill(unknown, torch.inf)
    usable = {name: as_batch(image).to(device) for name, image in replaced.items()}
    excluded = int(np.count_nonzero(no_traced | no_denoised | no_splat))
    return {**images, **usable, **auxiliary, "variance": variance}, excluded


def statistical(
    traced: Tensor, denoised: Tensor, splat: Tensor, albedo: Tensor, count: Tensor, quick: bool
) -> tuple[Tensor, Tensor]:
    """Radiance and weights (N, 3, H, W) of denoised samples and sharpened splats, by statistics alone.

    What denoising got wrong cannot be told from the samples that it has seen: where it is as good as the best
    filter, its error is orthogonal to what it leaves of them. It does follow a power of what was removed,
    though, at all sample counts alike. So the weights are logistic in the logarithms of what is seen, with
    coefficients (ODDS) that were fitted once, to many views of several scenes.

    All is measured in radiance x relative to its level l, as x / (x + l): that depends on no unit, and an
    outlier counts for 1 at most.

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
    lacking = _LACKING * torch.minimum(*found).clamp(-1, 1)
    return splat * torch.exp(lacking * texture)


def _seen(radiance: Tensor, level: Tensor) -> Tensor:
    return radiance / (radiance + level)
