"""A wall seen by all parents, and a network with opinions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from compose.fusion import combination
from compose.fusion.fitting import Example, FusionReference
from compose.fusion.network import Fusion
from compose.fusion.parents import Parents
from tests import small


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
        normal=np.broadcast_to(np.float32([0, 0, 1]), shape),
        count=np.full((size, size, 1), spp, dtype=np.float32),
        enlargement=2.0,
    )
    return Example(parents, FusionReference(truth, (truth, truth)), seed)


def radiance_of(given: Example) -> np.ndarray:
    """(H, W, 3) radiance that an example was made from."""
    return given.reference.denoised


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """(H, W, C) image, blurred by a Gaussian."""
    return gaussian_filter(image, (sigma, sigma, 0)).astype(np.float32)


def error(image: np.ndarray, truth: np.ndarray) -> float:
    """Mean squared error in dB."""
    return 10 * np.log10(np.mean((image - truth) ** 2))


def random_fusion() -> Fusion:
    """The network before fitting, but with random outputs."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        fusion = Fusion()
        torch.nn.init.normal_(fusion.judge.weight, std=0.3)
    return fusion.eval()


IMAGES = ("traced", "variance", "denoised", "splat", "albedo", "normal", "count")


@dataclass(frozen=True)
class PlainFused:
    """A Fused in host memory: radiance and weights (H, W, 3)."""

    radiance: np.ndarray
    weights: np.ndarray
    excluded: int


def fuse(parents: Parents, fusion: Fusion | None) -> PlainFused:
    """The estimate from all parents, in host memory."""
    found = combination.fuse(parents, fusion)
    return PlainFused(found.radiance.numpy(), found.weights.numpy(), found.excluded)


def in_torch(parents: Parents) -> Parents:
    """The same images as tensors."""
    return replace(parents, **{name: torch.from_numpy(np.array(getattr(parents, name))) for name in IMAGES})


def cropped(parents: Parents, height: int, width: int) -> Parents:
    """The upper left part of all images."""
    images = {name: getattr(parents, name)[:height, :width].copy() for name in IMAGES}
    return Parents(**images, enlargement=parents.enlargement, quick=parents.quick)
