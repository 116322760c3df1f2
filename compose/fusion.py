"""One estimate of foveal radiance from noisy traced pixels, their denoised picture, and biased splats.

The parents err in different places: the traced radiance is noisy, denoising blurs and invents, splats lack
detail and cannot follow what changed. A small convolutional network, fitted to a scene, looks at all of
them and says per pixel what each is worth. Three things are built around it:

- The splats are sharpened first: where the traced albedo varies within the size of a splat, so must the
  radiance. How much of that variation they lack is part of what the network says.
- The result is drawn towards the traced radiance wherever the two differ by more than noise explains, in
  the spirit of the James-Stein combiner of Gu et al. 2022: with more samples its weight goes to 1.
- What is not a number in one parent gets no weight.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

Image = NDArray[np.float32]

# Albedo below this is not told from black: its logarithm would be noise.
_DARK = 0.03
# Relative bias that no parent but the traced one is trusted to stay below.
_FLOOR = 0.005
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
    """

    traced: Image
    variance: Image
    denoised: Image
    splat: Image
    albedo: Image
    normal: Image
    count: Image
    enlargement: float

    def __post_init__(self) -> None:
        for field in fields(self)[:-1]:
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

    Works at half the resolution: a block of 2 x 2 pixels is one place with four times the channels.
    """

    CHANNELS = 32
    INPUTS = 31
    OUTPUTS = 9

    def __init__(self) -> None:
        super().__init__()
        self.reduce = torch.nn.Conv2d(self.INPUTS, self.CHANNELS, 2, stride=2)
        self.relate = torch.nn.Conv2d(self.CHANNELS, self.CHANNELS, 3, padding=1)
        self.judge = torch.nn.Conv2d(self.CHANNELS, 4 * self.OUTPUTS, 3, padding=1)
        torch.nn.init.zeros_(self.judge.weight)
        assert self.judge.bias is not None
        torch.nn.init.zeros_(self.judge.bias)

    def forward(self, features: Tensor) -> Tensor:
        """(N, OUTPUTS, H, W) from (N, INPUTS, H, W), both sides even."""
        hidden = functional.relu(self.reduce(features))
        hidden = functional.relu(self.relate(hidden))
        return functional.pixel_shuffle(self.judge(hidden), 2)


def perceived(radiance: Tensor) -> Tensor:
    """About what sRGB makes of radiance up to 1, and its logarithm beyond: finite slopes, no upper end."""
    low = (radiance.clamp(0, 1) + 1e-3) ** (1 / 2.2)
    return low + torch.log(radiance.clamp(min=1)) / 2.2


def _mean(image: Tensor, reach: int) -> Tensor:
    """Mean over windows of 2 reach + 1 pixels, borders repeated."""
    padded = functional.pad(image, (reach,) * 4, mode="replicate")
    return functional.avg_pool2d(padded, 2 * reach + 1, 1)


def _wide_mean(image: Tensor) -> Tensor:
    """Mean over some 16 x 16 pixels, at the price of one over 4 x 4."""
    small = functional.avg_pool2d(image, 4, ceil_mode=True)
    return functional.interpolate(_mean(small, 1), size=image.shape[-2:], mode="bilinear")


def _luminance(image: Tensor) -> Tensor:
    return 0.2126 * image[:, 0:1] + 0.7152 * image[:, 1:2] + 0.0722 * image[:, 2:3]


def texture(albedo: Tensor) -> list[Tensor]:
    """Logarithm of albedo over its mean in windows of 3, 7 and some 16 pixels: what a blur takes away."""
    means = (_mean(albedo, 1), _mean(albedo, 3), _wide_mean(albedo))
    return [torch.log((albedo + _DARK) / (mean + _DARK)) for mean in means]


def _spread(moments: Tensor) -> Tensor:
    return (moments[:, 1:2] - moments[:, 0:1] ** 2).clamp(min=0)


def features(
    traced: Tensor,
    denoised: Tensor,
    splat: Tensor,
    albedo: Tensor,
    normal: Tensor,
    count: Tensor,
    enlargement: Tensor,
) -> Tensor:
    """(N, INPUTS, H, W): what the network looks at.

    Images (N, 3, H, W), count of samples (N, 1, H, W), enlargement (N,).
    """
    seen_traced, seen_denoised, seen_splat = (perceived(image) for image in (traced, denoised, splat))
    residual = seen_traced - seen_denoised
    noise = _mean((residual**2).mean(1, keepdim=True), 2)
    # Whether splats and samples differ by more than noise: mean and t-value over small and large windows.
    expected = _luminance(splat) + 0.05
    ratio = ((_luminance(traced) - expected + 0.05) / expected).clamp(-8, 8)
    moments = torch.cat([ratio, ratio**2], 1)
    wide = _wide_mean(moments)
    # Where no light has been found yet a small window shows no spread; the neighbourhood tells of it.
    floor = _spread(wide)
    evidence = []
    for mean, pixels in ((_mean(moments, 2), 25), (wide, 144)):
        t = mean[:, 0:1] / torch.sqrt(torch.maximum(_spread(mean), floor) / pixels + 1e-4)
        evidence += [mean[:, 0:1].clamp(-1, 1), t / (3 + t.abs())]
    height, width = traced.shape[-2:]
    constant = torch.log2(enlargement).clamp(-2, 4).view(-1, 1, 1, 1).expand(-1, 1, height, width)
    return torch.cat(
        [
            seen_splat,
            seen_denoised - seen_splat,
            _luminance(residual),
            _mean(_luminance(residual), 1),
            *texture(albedo),
            albedo,
            normal,
            *evidence,
            torch.log(noise + 1e-5) / 4,
            (seen_denoised - seen_splat).abs().mean(1, keepdim=True),
            torch.log2(count.clamp(1, 64)) / 3 - 1,
            constant,
        ],
        1,
    )


def mixture(
    judged: Tensor, traced: Tensor, denoised: Tensor, splat: Tensor, albedo: Tensor
) -> tuple[Tensor, Tensor]:
    """Radiance (N, 3, H, W) and weights (N, 3, H, W) that the network's outputs mean."""
    weights = torch.softmax(judged[:, 0:3] + judged.new_tensor([-2.0, 0, 0]).view(1, 3, 1, 1), 1)
    gain = 0.5 * torch.tanh(judged[:, 6:9])
    for number, lost in enumerate(texture(albedo)):
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
    images, unusable = _usable(parents)
    traced, denoised, splat, albedo, normal = images
    if fusion is None:
        radiance, weights = statistical(traced, denoised, splat, as_batch(parents.variance))
    else:
        with torch.inference_mode():
            enlargement = torch.tensor([float(parents.enlargement)])
            looked_at = features(*images, as_batch(parents.count), enlargement)
            judged = _evenly(fusion, looked_at)
            radiance, weights = mixture(judged, traced, denoised, splat, albedo)
    share = trust(radiance, traced, as_batch(parents.variance))
    radiance = torch.lerp(traced, radiance, share)
    weights = weights * share
    weights[:, 0:1] += 1 - share
    return Fused(_interleaved(radiance), _interleaved(weights), unusable)


def statistical(traced: Tensor, denoised: Tensor, splat: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """The splats' bias against the variance of the denoised samples, without anything fitted.

    The squared bias is what of the squared difference between samples and splats, averaged over 7 x 7
    pixels, variance does not explain; denoising is taken to average over as many pixels.
    """
    known = torch.where(torch.isfinite(variance), variance, _mean((traced - denoised) ** 2, 3))
    explained = _mean(known.mean(1, keepdim=True), 3)
    bias = (_mean(((traced - splat) ** 2).mean(1, keepdim=True), 3) - explained).clamp(min=0)
    share = bias / (bias + explained / 49 + 1e-8)
    weights = torch.cat([torch.zeros_like(share), share, 1 - share], 1)
    return torch.lerp(splat, denoised, share), weights


def trust(estimate: Tensor, traced: Tensor, variance: Tensor) -> Tensor:
    """(N, 1, H, W): share that an estimate of unknown bias keeps beside the unbiased one, 0..1.

    v / (v + b^2) is the best share for independent errors of variance v and bias b. The squared bias is
    estimated over 7 x 7 pixels, and taken at the lower end of its confidence interval (two standard
    errors): noise alone must not count as bias.
    """
    known = torch.isfinite(variance)
    explained = torch.where(known, variance, 0).mean(1, keepdim=True)
    excess = ((estimate - traced) ** 2).mean(1, keepdim=True) - explained
    first, second = _mean(excess, 3), _mean(excess**2, 3)
    error = torch.sqrt((second - first**2).clamp(min=0) / 49)
    floor = (_FLOOR * _luminance(estimate)) ** 2
    bias = torch.maximum(first - 2 * error, floor)
    explained = _mean(explained, 3)
    share = explained / (explained + bias + 1e-20)
    return torch.where(known.all(1, keepdim=True), share, 1.0)


def _usable(parents: Parents) -> tuple[list[Tensor], int]:
    """The images, and how many pixels had to be taken from another parent."""
    images = [
        getattr(parents, name).astype(np.float32)
        for name in ("traced", "denoised", "splat", "albedo", "normal")
    ]
    bad = [(~np.isfinite(image) | (image < 0)).any(axis=-1) for image in images[:3]]
    traced, denoised, splat = images[:3]
    # The denoised picture has seen its neighbours: it is the first to stand in for another.
    denoised = np.where(bad[1][..., None], np.where(bad[2][..., None], 0, splat), denoised)
    images[:3] = (
        np.where(bad[0][..., None], denoised, traced),
        denoised,
        np.where(bad[2][..., None], denoised, splat),
    )
    images[3:] = (np.nan_to_num(image, posinf=0, neginf=0) for image in images[3:])
    return [as_batch(image) for image in images], int(np.count_nonzero(bad[0] | bad[1] | bad[2]))


def _evenly(fusion: Fusion, looked_at: Tensor) -> Tensor:
    """The network's outputs, for pictures with odd sides as well."""
    height, width = looked_at.shape[-2:]
    padded = functional.pad(looked_at, (0, width % 2, 0, height % 2), mode="replicate")
    return fusion(padded)[..., :height, :width]


def as_batch(image: Image) -> Tensor:
    """(1, C, H, W) of an image (H, W, C)."""
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(image, -1, 0)))[None]


def _interleaved(images: Tensor) -> Image:
    return np.ascontiguousarray(np.moveaxis(images[0].numpy(), 0, -1))
