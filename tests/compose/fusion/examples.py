"""Parents in host memory, a wall seen by all of them, and the fusion of such parents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, uniform_filter

from compose.fusion.combination import Fusion, trust
from compose.fusion.parents import TYPICAL_ERROR, Parents
from tests import small
from tests.available import available_arrays
from tests.compose.arrays_of import channels, host, indices


@dataclass(frozen=True)
class PlainParents:
    """Parents as host images (H, W, C)."""

    traced: np.ndarray
    variance: np.ndarray
    splat: np.ndarray
    albedo: np.ndarray
    count: np.ndarray
    earlier: np.ndarray
    denoised: np.ndarray | None = None
    expected: float = TYPICAL_ERROR

    def images(self) -> dict[str, np.ndarray]:
        """All images that there are, by name."""
        return {name: of for name, of in vars(self).items() if isinstance(of, np.ndarray)}

    def on_device(self) -> Parents:
        """The same on the device."""
        return Parents.of_images(available_arrays(), self.images(), self.expected)


@dataclass(frozen=True)
class Example:
    """Parents, and the radiance (H, W, 3) that they were made from."""

    parents: PlainParents
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
    parents = PlainParents(
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


def smooth(image: object) -> object:
    """A denoiser of a tensor (H, W, 3): blurs over 9 pixels."""
    blurred_image = np.array(image)
    for _ in range(4):
        blurred_image = uniform_filter(blurred_image, (3, 3, 1), mode="nearest")
    return type(image)(blurred_image)


@dataclass(frozen=True)
class PlainFused:
    """A Fused in host memory: radiance (H, W, 3) and weights (H, W, 4)."""

    radiance: np.ndarray
    weights: np.ndarray
    excluded: int


def fuse(parents: PlainParents) -> PlainFused:
    """The estimate from all parents, in host memory."""
    fusion, pixels = Fusion(parents.on_device()), everywhere(parents)
    found = fusion.fused(smooth(fusion.ratio), pixels)
    images = (image_of(parents, of) for of in (found.radiance, found.weights))
    return PlainFused(*images, found.excluded)


def estimate(parents: PlainParents) -> np.ndarray:
    """(H, W, 3) the estimate before it is drawn towards the samples."""
    fusion = Fusion(parents.on_device())
    return image_of(parents, fusion.estimate(smooth(fusion.ratio), everywhere(parents)))


def trusted(estimate: np.ndarray, **images: np.ndarray) -> np.ndarray:
    """(H, W) the trust in an estimate (H, W, 3), given traced radiance, its variance and the count."""
    like = dict.fromkeys(("splat", "albedo"), estimate)
    given = PlainParents(**images, **like, earlier=0 * images["count"]).on_device()
    flat = channels(available_arrays(), np.broadcast_to(estimate, (*given.shape, 3)).reshape(-1, 3))
    share = trust(given.grids, given.planes, flat)
    return np.array(share)[: given.shape[0] * given.shape[1]].reshape(given.shape)


def everywhere(parents: PlainParents) -> object:
    """Row-major indices of all pixels."""
    return indices(available_arrays(), np.arange(parents.count.size))


def image_of(parents: PlainParents, found: list[object]) -> np.ndarray:
    """(H, W, C) of channels (H * W,)."""
    return host(found).reshape(*parents.count.shape[:2], len(found))


def cropped(parents: PlainParents, height: int, width: int) -> PlainParents:
    """The upper left part of all images."""
    return PlainParents(**{name: getattr(parents, name)[:height, :width].copy() for name in IMAGES})
