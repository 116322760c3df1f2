"""One estimate of foveal radiance from noisy samples, denoised samples, and biased splats.

The traced radiance is noisy, denoising blurs and invents, splats lack detail and cannot follow changes. The
estimate is a mixture of the splats, as they are and as the samples correct them, and the denoised samples
(compose.fusion.estimates). Two things are built around that:

- The result is drawn towards the traced radiance wherever the two differ by more than noise explains, in
  the spirit of the James-Stein combiner of Gu et al. 2022: with more samples the weight of these goes to 1.
- A parent that is negative, not finite or out of all proportion in a pixel is replaced by another one there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from compose.fusion.estimates import dark_of, evidence, ratio_of, relit, shares, sharpened, texture_of
from compose.fusion.parents import (
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
_RADIANCE = "traced", "denoised", "splat"


class Fusion:
    """The fusion of a view's parents, in two steps, since what its splats are relit by is denoised between.

    Attributes:
        ratio: (1, 3, h, w), of samples and splats at half the resolution, with the samples' noise.
    """

    def __init__(self, parents: Parents):
        self._size, self._expected = parents.traced.shape[:2], parents.expected
        with torch.inference_mode():
            self._images, self._plain, self._excluded = _prepared(parents)
            traced, splat = self._images["traced"], self._images["splat"]
            self._dark = dark_of(traced, splat)
            self._level = splat.mean(1, keepdim=True) + self._dark
            self._sharp = sharpened(splat, texture_of(self._images["albedo"]), traced, self._level)
            self.ratio = ratio_of(traced, self._sharp, self._dark)

    @torch.inference_mode()
    def fused(self, smooth: Tensor) -> Fused:
        """One estimate from all parents, and their weights; `smooth` is the denoised ratio."""
        images, (estimate, weights) = self._images, self._mixed(smooth)
        kept = trust(estimate, images["traced"], images["variance"], images["count"], self._plain)
        weights = torch.cat([1 - kept, kept * weights], 1)
        radiance = torch.lerp(images["traced"], estimate, kept)
        return Fused(self._whole(radiance), self._whole(weights), self._excluded)

    @torch.inference_mode()
    def estimate(self, smooth: Tensor) -> Tensor:
        """(H, W, 3) the estimate before it is drawn towards the samples; `smooth` is the denoised ratio."""
        return self._whole(self._mixed(smooth)[0])

    @torch.inference_mode()
    def candidates(self, smooth: Tensor) -> list[Tensor]:
        """(1, 3, H, W) each: splats, relit splats and, if there are any, denoised samples."""
        light = relit(self._sharp, smooth, self._dark)
        return [self._sharp, light, *([self._images["denoised"]] if "denoised" in self._images else [])]

    @torch.inference_mode()
    def evidence(self, candidates: Sequence[Tensor]) -> Tensor:
        """What their shares depend on (compose.fusion.estimates.evidence)."""
        return evidence(candidates, self._images, self._level, self._expected)

    def _mixed(self, smooth: Tensor) -> tuple[Tensor, Tensor]:
        """Radiance (1, 3, H, W), and the weights in it of all PARENTS but the first."""
        found = self.candidates(smooth)
        weights = shares(self.evidence(found), found[0])
        radiance = torch.zeros_like(found[0])
        for number, image in enumerate(found):
            radiance += weights[:, number : number + 1] * image
        if len(found) < len(PARENTS) - 1:
            weights = torch.cat([weights, torch.zeros_like(weights[:, :1])], 1)
        return radiance, weights.flip(1)

    def _whole(self, image: Tensor) -> Tensor:
        """(H, W, C) of an image whose sides are even."""
        height, width = self._size
        return image[0, :, :height, :width].permute(1, 2, 0)


def _prepared(parents: Parents) -> tuple[dict[str, Tensor], bool, int]:
    """The parents as images (1, C, H, W) by name, both sides even.

    Returns also whether all radiance is plain, from 0 to MOST, and in how many pixels it was replaced.
    """
    images = {name: as_batch(image) for name, image in parents.images().items()}
    # The least and the largest radiance of the parents, and whether the albedo is finite: together, since a
    # card is waited for. A number that is none is the least and the largest one, too.
    ends = torch.aminmax(torch.cat([images[name] for name in _RADIANCE if name in images]))
    known = torch.isfinite(images["albedo"]).all().to(ends.min.dtype)
    least, most, finite = torch.stack([*ends, known]).tolist()
    plain, excluded = least >= 0 and most <= MOST and finite == 1, 0
    if not plain:
        images, excluded = _usable(images)
    return {name: padded_to_even(image) for name, image in images.items()}, plain, excluded


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
    found = {n: images[n][0].permute(1, 2, 0).cpu().numpy() for n in _RADIANCE if n in images}
    traced, splat = found["traced"], found["splat"]
    # (H, W, 1) each. Where splats and denoised samples are wrong, they are so in whole patches.
    no_traced = outliers(traced, splat)
    samples = np.where(no_traced, 0, traced)
    no_splat = wrong = outliers(splat, samples, beside=False)
    usable_splat = np.where(no_splat, 0, splat)
    # Denoising has used the neighbouring pixels, so its result is the first substitute for the others.
    for_traced, for_splat = usable_splat, samples
    if "denoised" in found:
        no_denoised = outliers(found["denoised"], samples, usable_splat, beside=False)
        for_traced = for_splat = found["denoised"] = np.where(no_denoised, usable_splat, found["denoised"])
        wrong = wrong | no_denoised
    found["traced"], found["splat"] = (
        np.where(no_traced, for_traced, traced),
        np.where(no_splat, for_splat, splat),
    )
    device = images["traced"].device
    unknown = as_batch(no_traced.astype(np.float32)).bool().to(device)
    features = {
        "albedo": torch.nan_to_num(images["albedo"], posinf=0, neginf=0),
        "variance": images["variance"].masked_fill(unknown, torch.inf),
    }
    usable = {name: as_batch(image).to(device) for name, image in found.items()}
    return {**images, **usable, **features}, int(np.count_nonzero(no_traced | wrong))
