"""One estimate of foveal radiance from noisy traced pixels, their denoised picture, and biased splats.

The parents err in different places: the traced radiance is noisy, denoising blurs and invents, splats lack
detail and cannot follow what changed. A small convolutional network, fitted to a scene, looks at all of
them and says per pixel what each is worth. Three things are built around it:

- The splats are sharpened first: where the traced albedo varies within the size of a splat, so must the
  radiance. How much of that variation they lack is part of what the network says.
- Where there are many samples, they tell whether the denoised ones are nearer to the truth than what the
  network says, which has never seen so many.
- The result is drawn towards the traced radiance wherever the two differ by more than noise explains, in
  the spirit of the James-Stein combiner of Gu et al. 2022: with more samples its weight goes to 1.
- What is not a number in one parent gets no weight.
"""

from __future__ import annotations

import os

import numpy as np
import torch
from torch import Tensor

from compose.fusion.features import features_of, variance_of
from compose.fusion.maps import as_batch, box_mean, enlarged, halved, luminance, padded_to_even
from compose.fusion.network import Fusion, mixture
from compose.fusion.parents import Fused, Parents
from compose.image.colour import Image

# torch keeps what it has compiled for pictures of each size, a thousand times by default, and a disc near the
# edge of a frame has another size at every gaze: 170 kB for each. Read at the first convolution.
for _capacity in ("LRU_CACHE_CAPACITY", "ONEDNN_PRIMITIVE_CACHE_CAPACITY"):
    os.environ.setdefault(_capacity, "64")

# Relative bias that no parent but the traced one is trusted to stay below.
_FLOOR = 0.005
# How much wider than a normal distribution's the interval around a few samples' bias may be.
_TAILS = 20.0
# From so many samples per pixel on the samples can tell whether denoising them has come nearer to the truth
# than the network, and how strongly their noise is held against that.
_TELLING_COUNT = 32
_CAUTION = 24.0
# With fewer samples per pixel the better denoiser costs more than it is worth.
QUICK_BELOW = 3.0


def fuse(parents: Parents, fusion: Fusion | None) -> Fused:
    """One estimate from all parents.

    Args:
        parents: pictures of one view.
        fusion: fitted to the scene; None decides by `statistical` instead.
    """
    height, width = parents.traced.shape[:2]
    usable, excluded = _usable(parents)
    interleaved = lambda found: found[0, :, :height, :width].permute(1, 2, 0).numpy()  # noqa: E731
    with torch.inference_mode():
        # The network judges blocks of 2 x 2.
        even = [padded_to_even(as_batch(image)) for image in usable]
        *images, variance, count = even
        traced, denoised, splat = images[:3]
        if fusion is None:
            radiance, weights = statistical(traced, denoised, splat, variance)
        else:
            # The network knows the quicker denoiser from pictures with few samples.
            known = count.clamp(max=QUICK_BELOW) if parents.quick else count
            features = features_of(images, known, torch.tensor([float(parents.enlargement)]))
            radiance, weights = mixture(fusion(features), images[:3], features.texture)
        if float(count.mean()) >= _TELLING_COUNT:
            share = regressed(radiance, denoised, traced, variance)
            radiance, weights = torch.lerp(radiance, denoised, share), weights * (1 - share)
            weights[:, 1:2] += share
        share = trust(radiance, traced, variance, count)
        radiance = torch.lerp(traced, radiance, share)
        weights = weights * share
        weights[:, 0:1] += 1 - share
    return Fused(interleaved(radiance), interleaved(weights), excluded)


def statistical(traced: Tensor, denoised: Tensor, splat: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """The splats' bias against the variance of the denoised samples, without anything fitted.

    The squared bias is what of the squared difference between samples and splats, averaged over some 6 x 6
    pixels, variance does not explain; denoising is taken to average over as many pixels.
    """
    known = torch.where(torch.isfinite(variance), variance, (traced - denoised) ** 2)
    explained = box_mean(halved(known.mean(1, keepdim=True)))
    found = box_mean(halved(((traced - splat) ** 2).mean(1, keepdim=True)))
    bias = (found - explained).clamp(min=0)
    share = enlarged(bias / (bias + explained / 36 + 1e-8), splat)
    weights = torch.cat([torch.zeros_like(share), share, 1 - share], 1)
    return torch.lerp(splat, denoised, share), weights


def regressed(estimate: Tensor, other: Tensor, traced: Tensor, variance: Tensor) -> Tensor:
    """(N, 1, H, W): how far on the way from an estimate to another one the traced radiance lies, 0..1.

    The place is that of least squares over some 6 x 6 pixels. The variance of their mean is added to the
    squared length of the way: where the two estimates differ by less than noise, the first one is kept.
    """
    known = torch.isfinite(variance).all(1, keepdim=True)
    noise = torch.where(known, variance, 0).mean(1, keepdim=True)
    way = other - estimate
    along = ((traced - estimate) * way).mean(1, keepdim=True)
    maps = box_mean(halved(torch.cat([along, (way**2).mean(1, keepdim=True), noise], 1)))
    share = maps[:, 0:1] / (maps[:, 1:2] + _CAUTION * maps[:, 2:3] / 36 + 1e-12)
    return torch.where(known, enlarged(share.clamp(0, 1), traced), 0.0)


def trust(estimate: Tensor, traced: Tensor, variance: Tensor, count: Tensor) -> Tensor:
    """(N, 1, H, W): share that an estimate of unknown bias keeps beside the unbiased one, 0..1.

    v / (v + b^2) is the best share for independent errors of variance v and bias b. The squared bias is
    estimated over some 6 x 6 pixels, and taken at the lower end of its confidence interval (two standard
    errors): noise must not count as bias. Where few samples have found any light yet, both they and their
    variance are too small together, so that the neighbourhood's relative variance counts where it is larger;
    and the fewer the samples, the wider the interval may be.
    """
    known = torch.isfinite(variance).all(1, keepdim=True)
    explained = torch.where(known, variance, 0).mean(1, keepdim=True)
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
    return torch.where(known, enlarged(share, traced), 1.0)


def _usable(parents: Parents) -> tuple[list[Image], int]:
    """Traced, denoised, splat, albedo, normal, variance, count; and how many pixels were replaced."""
    images = [parents.traced, parents.denoised, parents.splat]
    others = [parents.albedo, parents.normal, parents.variance, parents.count]
    # Minimum and sum tell at once that nothing is wrong, as is nearly always so.
    if all(np.isfinite(image.sum()) and image.min() >= 0 for image in images) and all(
        np.isfinite(guide.sum()) for guide in others[:2]
    ):
        return images + others, 0
    bad = [(~np.isfinite(image) | (image < 0)).any(axis=-1, keepdims=True) for image in images]
    traced, denoised, splat = images
    # The denoised picture has seen its neighbours: it is the first to stand in for another.
    denoised = np.where(bad[1], np.where(bad[2], 0, splat), denoised)
    images = [np.where(bad[0], denoised, traced), denoised, np.where(bad[2], denoised, splat)]
    others[:2] = (np.nan_to_num(guide, posinf=0, neginf=0) for guide in others[:2])
    others[2] = np.where(bad[0], np.inf, others[2])
    return images + others, int(np.count_nonzero(bad[0] | bad[1] | bad[2]))
