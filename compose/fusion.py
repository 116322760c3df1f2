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
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from compose.blend import Image

# torch keeps what it has compiled for pictures of each size, a thousand times by default, and a disc near the
# edge of a frame has another size at every gaze: 170 kB for each. Read at the first convolution.
for _capacity in ("LRU_CACHE_CAPACITY", "ONEDNN_PRIMITIVE_CACHE_CAPACITY"):
    os.environ.setdefault(_capacity, "64")

# Albedo below this is not told from black: its logarithm would be noise.
_DARK = 0.03
# Relative bias that no parent but the traced one is trusted to stay below.
_FLOOR = 0.005
# How much wider than a normal distribution's the interval around a few samples' bias may be.
_TAILS = 20.0
# Least spread of the samples anywhere, in that of the whole picture.
_SPREAD = 0.5
# From so many samples per pixel on the samples can tell whether denoising them has come nearer to the truth
# than the network, and how strongly their noise is held against that.
_TELLING_COUNT = 32
_CAUTION = 24.0
# With fewer samples per pixel the better denoiser costs more than it is worth.
QUICK_BELOW = 3.0
# Parents, in the order of their weights.
PARENTS = ("traced", "denoised", "splat")


@dataclass(frozen=True)
class Parents:
    """What is known of one picture.

    Attributes:
        traced: (H, W, 3) mean of the path-traced samples, linear radiance.
        variance: (H, W, 3) of that mean; inf where it is not known.
        denoised: (H, W, 3) the same samples, denoised.
        splat: (H, W, 3) the splats' picture of the same view.
        albedo, normal: (H, W, 3) of the same samples.
        count: (H, W, 1) how many samples.
        enlargement: side of the pixels that the splats were trained on, in pixels of this picture.
        quickly_denoised: whether by the quicker denoiser, though there may be many samples.
    """

    traced: Image
    variance: Image
    denoised: Image
    splat: Image
    albedo: Image
    normal: Image
    count: Image
    enlargement: float
    quickly_denoised: bool = False

    def __post_init__(self) -> None:
        for field in fields(self)[:-2]:
            shape = getattr(self, field.name).shape
            expected = (*self.traced.shape[:2], 1 if field.name == "count" else 3)
            if shape != expected:
                raise ValueError(f"{field.name} is {shape}, must be {expected} as traced is")


@dataclass(frozen=True)
class Fused:
    """One estimate of radiance.

    Attributes:
        radiance: (H, W, 3) linear.
        weights: (H, W, 3) share of each parent, in the order of PARENTS.
        excluded: pixels in which a parent was not finite or negative, and left out.
    """

    radiance: Image
    weights: Image
    excluded: int


class Fusion(torch.nn.Module):
    """The fitted part: what each parent is worth, from what they show.

    It judges blocks of 2 x 2 pixels, each pixel for itself.
    """

    CHANNELS = 24
    OUTPUTS = 9

    def __init__(self) -> None:
        super().__init__()
        self.reduce = torch.nn.Conv2d(Looks.FINE, self.CHANNELS, 2, stride=2)
        self.relate = torch.nn.Conv2d(self.CHANNELS + Looks.COARSE, self.CHANNELS, 3, padding=1)
        self.judge = torch.nn.Conv2d(self.CHANNELS, 4 * self.OUTPUTS, 3, padding=1)
        torch.nn.init.zeros_(self.judge.weight)
        assert self.judge.bias is not None
        torch.nn.init.zeros_(self.judge.bias)

    def forward(self, looks: Looks) -> Tensor:
        """(N, OUTPUTS, H, W)."""
        # Convolutions are quickest with channels last, all else with channels first.
        coarse = looks.coarse.contiguous(memory_format=torch.channels_last)
        fine = looks.fine.contiguous(memory_format=torch.channels_last)
        hidden = torch.cat([functional.relu(self.reduce(fine)), coarse], 1)
        hidden = functional.relu(self.relate(hidden))
        return functional.pixel_shuffle(self.judge(hidden), 2).contiguous()


@dataclass(frozen=True)
class Looks:
    """What the network looks at, and the texture that it may give the splats.

    Attributes:
        fine: (N, FINE, H, W).
        coarse: (N, COARSE, H / 2, W / 2).
        texture: three of (N, 3, H, W): logarithm of the albedo over its mean in windows of 3, 6 and 12
            pixels, which is what a blur of that size takes from a picture.
    """

    FINE: ClassVar[int] = 10
    COARSE: ClassVar[int] = 21

    fine: Tensor
    coarse: Tensor
    texture: list[Tensor]


def perceived(radiance: Tensor) -> Tensor:
    """About what sRGB makes of radiance up to 1, and slower growth beyond: finite slopes, no upper end.

    Square roots take a tenth of the time of other powers.
    """
    low = torch.sqrt(radiance.clamp(0, 1) + 1e-3)
    return low + 2 * (torch.sqrt(torch.sqrt(radiance.clamp(min=1))) - 1)


def _mean(image: Tensor) -> Tensor:
    """Mean over windows of 3 x 3 pixels, borders repeated; pooling takes seven times as long."""
    image = functional.pad(image, (1, 1, 1, 1), mode="replicate")
    image = image[..., :-2] + image[..., 1:-1] + image[..., 2:]
    return (image[..., :-2, :] + image[..., 1:-1, :] + image[..., 2:, :]) / 9


def _halved(image: Tensor) -> Tensor:
    """Means of 2 x 2 pixels, at odd ends of fewer; for even sides, pooling takes three times as long."""
    if image.shape[-1] % 2 or image.shape[-2] % 2:
        return functional.avg_pool2d(image, 2, ceil_mode=True)
    return 0.25 * (
        image[..., ::2, ::2] + image[..., 1::2, ::2] + image[..., ::2, 1::2] + image[..., 1::2, 1::2]
    )


def _enlarged(image: Tensor, like: Tensor) -> Tensor:
    return functional.interpolate(image, size=like.shape[-2:], mode="bilinear")


def _luminance(image: Tensor) -> Tensor:
    return 0.2126 * image[:, 0:1] + 0.7152 * image[:, 1:2] + 0.0722 * image[:, 2:3]


def _spread(moments: Tensor) -> Tensor:
    return (moments[:, 1:2] - moments[:, 0:1] ** 2).clamp(min=0)


def _evidence(traced: Tensor, splat: Tensor) -> list[Tensor]:
    """Whether samples and splats differ by more than noise, at half the resolution.

    Mean of their relative difference, and its t-value, over windows of 6 and of 12 pixels.
    """
    expected = _luminance(splat) + 0.05
    ratio = ((_luminance(traced) + 0.05) / expected - 1).clamp(-8, 8)
    moments = _halved(torch.cat([ratio, ratio**2], 1))
    small, large = _mean(moments), _enlarged(_mean(_halved(moments)), moments)
    # Where no light has been found yet a small window shows no spread; the neighbourhood and the whole
    # picture tell of it.
    everywhere = _spread(moments) * _halved(expected)
    everywhere = everywhere.mean((2, 3), keepdim=True) / expected.mean((2, 3), keepdim=True)
    floor = torch.maximum(_spread(large), _SPREAD * everywhere)
    found = []
    for mean, pixels in ((small, 36), (large, 144)):
        t = mean[:, 0:1] / torch.sqrt(torch.maximum(_spread(mean), floor) / pixels + 1e-4)
        found += [mean[:, 0:1].clamp(-1, 1), t / (3 + t.abs())]
    return found


def looks_of(images: Sequence[Tensor], count: Tensor, enlargement: Tensor) -> Looks:
    """What the network looks at.

    Args:
        images: traced, denoised, splat, albedo, normal, each (N, 3, H, W), both sides even.
        count: (N, 1, H, W) samples.
        enlargement: (N,).
    """
    traced, denoised, splat, albedo, normal = images
    seen_denoised, seen_splat = perceived(denoised), perceived(splat)
    residual = _luminance(perceived(traced) - seen_denoised)
    difference = seen_denoised - seen_splat
    logarithm, coarse_albedo = torch.log(albedo + _DARK), _halved(albedo)
    means = [_mean(coarse_albedo), _mean(_halved(coarse_albedo))]
    blurred = [torch.log(mean + _DARK) for mean in (_mean(albedo), *means)]
    texture = [logarithm - blurred[0], *(logarithm - _enlarged(mean, logarithm) for mean in blurred[1:])]
    coarse_logarithm = torch.log(coarse_albedo + _DARK)
    constant = torch.log2(enlargement).clamp(-2, 4).view(-1, 1, 1, 1)
    moments = _mean(_halved(torch.cat([residual, residual**2], 1)))
    coarse = [
        coarse_albedo,
        _halved(normal),
        coarse_logarithm - blurred[1],
        coarse_logarithm - _enlarged(blurred[2], coarse_logarithm),
        *_evidence(traced, splat),
        moments[:, 0:1],
        torch.log(moments[:, 1:2] + 1e-5) / 4,
        _halved(difference.abs().mean(1, keepdim=True)),
        torch.log2(_halved(count).clamp(1, 64)) / 3 - 1,
        constant.expand(-1, 1, *coarse_albedo.shape[-2:]),
    ]
    return Looks(torch.cat([seen_splat, difference, texture[0], residual], 1), torch.cat(coarse, 1), texture)


def mixture(judged: Tensor, parents: Sequence[Tensor], texture: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Radiance (N, 3, H, W) and weights (N, 3, H, W) that the network's outputs mean."""
    traced, denoised, splat = parents
    weights = torch.softmax(judged[:, 0:3] + judged.new_tensor([-2.0, 0, 0]).view(1, 3, 1, 1), 1)
    gain = 0.5 * torch.tanh(judged[:, 6:9])
    for number, lost in enumerate(texture):
        gain = gain + judged[:, 3 + number : 4 + number] * lost
    sharpened = splat * torch.exp(gain.clamp(-2, 2))
    radiance = weights[:, 0:1] * traced + weights[:, 1:2] * denoised + weights[:, 2:3] * sharpened
    return radiance, weights


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
        even = [_even(as_batch(image)) for image in usable]
        *images, variance, count = even
        traced, denoised, splat = images[:3]
        if fusion is None:
            radiance, weights = statistical(traced, denoised, splat, variance)
        else:
            # The network knows the quicker denoiser from pictures with few samples.
            known = count.clamp(max=QUICK_BELOW) if parents.quickly_denoised else count
            looks = looks_of(images, known, torch.tensor([float(parents.enlargement)]))
            radiance, weights = mixture(fusion(looks), images[:3], looks.texture)
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
    explained = _mean(_halved(known.mean(1, keepdim=True)))
    found = _mean(_halved(((traced - splat) ** 2).mean(1, keepdim=True)))
    bias = (found - explained).clamp(min=0)
    share = _enlarged(bias / (bias + explained / 36 + 1e-8), splat)
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
    maps = _mean(_halved(torch.cat([along, (way**2).mean(1, keepdim=True), noise], 1)))
    share = maps[:, 0:1] / (maps[:, 1:2] + _CAUTION * maps[:, 2:3] / 36 + 1e-12)
    return torch.where(known, _enlarged(share.clamp(0, 1), traced), 0.0)


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
    level = _luminance(estimate) ** 2 + 1e-8
    maps = _halved(torch.cat([excess, excess**2, explained, level], 1))
    small, large = _mean(maps), _enlarged(_mean(_halved(_halved(maps))), maps)
    level = small[:, 3:4]
    explained = torch.maximum(small[:, 2:3], large[:, 2:3] / large[:, 3:4] * level)
    error = torch.sqrt(torch.maximum(_spread(small), _spread(large)) / 36)
    error = torch.minimum(error, explained * (1.5 + _TAILS / torch.sqrt(_halved(count))))
    bias = torch.maximum(small[:, 0:1] - 2 * error, _FLOOR**2 * level)
    share = explained / (explained + bias + 1e-20)
    return torch.where(known, _enlarged(share, traced), 1.0)


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


def as_batch(image: Image) -> Tensor:
    """(1, C, H, W) of an image (H, W, C)."""
    return torch.from_numpy(np.ascontiguousarray(image, dtype=np.float32)).permute(2, 0, 1).contiguous()[None]


def _even(image: Tensor) -> Tensor:
    """With the last row or column repeated where their number is odd."""
    height, width = image.shape[-2:]
    if not (height % 2 or width % 2):
        return image
    return functional.pad(image, (0, width % 2, 0, height % 2), mode="replicate")
