"""A wall seen by all parents."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from compose.fusion.combination import Fusion
from compose.fusion.parents import Parents, box_mean
from tests import small


@dataclass(frozen=True)
class Example:
    """Parents, and the radiance (H, W, 3) that they were made from."""

    parents: Parents
    radiance: np.ndarray


def example(seed: int, spp: int, size: int = 96) -> Example:
    """A textured wall in soft light: splats that blur, samples that are noisy, a denoiser that blurs more."""
    rng = small.rng(seed)
    albedo = np.kron(rng.uniform(0.1, 0.9, (size // 8, size // 8, 3)), np.ones((8, 8, 1))).astype(np.float32)
    light = 2 * blurred(rng.uniform(0, 1, (size, size, 1)).astype(np.float32), 16) ** 2 + 0.3
    truth = (albedo * light).astype(np.float32)
    traced = (truth * rng.gamma(spp / 2, 2 / spp, truth.shape)).astype(np.float32)
    denoised = blurred(traced / (albedo + 0.01), 2) * (albedo + 0.01)
    shape = (size, size, 3)
    parents = Parents(
        traced=traced,
        variance=np.broadcast_to(truth**2 * 2 / spp, shape).astype(np.float32),
        denoised=denoised.astype(np.float32),
        splat=blurred(truth, 1.5),
        albedo=albedo,
        count=np.full((size, size, 1), spp, dtype=np.float32),
        earlier=np.zeros((size, size, 1), dtype=np.float32),
    )
    return Example(parents, truth)


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """(H, W, C) image, blurred by a Gaussian."""
    return gaussian_filter(image, (sigma, sigma, 0)).astype(np.float32)


def error(image: np.ndarray, truth: np.ndarray) -> float:
    """Mean squared error in dB."""
    return 10 * np.log10(np.mean((image - truth) ** 2))


IMAGES = ("traced", "variance", "denoised", "splat", "albedo", "count", "earlier")


def smooth(image: torch.Tensor) -> torch.Tensor:
    """A denoiser: blurs over 9 pixels."""
    return box_mean(box_mean(box_mean(box_mean(image))))


@dataclass(frozen=True)
class PlainFused:
    """A Fused in host memory: radiance (H, W, 3) and weights (H, W, 4)."""

    radiance: np.ndarray
    weights: np.ndarray
    excluded: int


def fuse(parents: Parents) -> PlainFused:
    """The estimate from all parents, in host memory."""
    fusion = Fusion(parents)
    found = fusion.fused(smooth(fusion.ratio))
    return PlainFused(found.radiance.numpy(), found.weights.numpy(), found.excluded)


def estimate(parents: Parents) -> np.ndarray:
    """(H, W, 3) the estimate before it is drawn towards the samples."""
    fusion = Fusion(parents)
    return fusion.estimate(smooth(fusion.ratio)).numpy()


def in_torch(parents: Parents) -> Parents:
    """The same images as tensors."""
    return replace(parents, **{name: torch.from_numpy(np.array(getattr(parents, name))) for name in IMAGES})


def cropped(parents: Parents, height: int, width: int) -> Parents:
    """The upper left part of all images."""
    return Parents(**{name: getattr(parents, name)[:height, :width].copy() for name in IMAGES})
