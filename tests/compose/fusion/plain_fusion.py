"""The fusion in plain NumPy and float64; images are (H, W, C)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.fusion import estimates as module
from tests.compose.fusion.examples import PlainParents

Array = NDArray[np.float64]


def box_mean(image: Array) -> Array:
    """Means over windows of 3 x 3 pixels."""
    # Not by running sums, in which what is large would leave its rounding behind.
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge")
    height, width = image.shape[:2]
    return sum(padded[i : i + height, j : j + width] for i in range(3) for j in range(3)) / 9


def block_means(image: Array, side: int) -> Array:
    """Means over blocks of pixels, of those that there are."""
    rows, columns = (np.arange(0, size, side) for size in image.shape[:2])
    sums = np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1)
    ones = np.ones((*image.shape[:2], 1))
    return sums / np.add.reduceat(np.add.reduceat(ones, rows, axis=0), columns, axis=1)


def block_means_around(image: Array, side: int, margin: int) -> Array:
    """Means over blocks and what lies around them, pixel by pixel."""
    height, width = image.shape[:2]
    rows, columns = (range(0, size, side) for size in (height, width))
    part = lambda start, size: slice(max(start - margin, 0), min(start + side + margin, size))  # noqa: E731
    return np.array([[image[part(i, height), part(j, width)].mean((0, 1)) for j in columns] for i in rows])


def enlarged(coarse: Array, side: int, shape: tuple[int, ...]) -> Array:
    """A coarse image, each of whose pixels covers so many a side, between the centres of its pixels."""
    for axis in range(2):
        at = (np.arange(shape[axis]) + 0.5) / side - 0.5
        one = lambda values, at=at: np.interp(at, np.arange(len(values)), values)  # noqa: E731
        coarse = np.apply_along_axis(one, axis, coarse)
    return coarse


def smoothed(ratio: Array) -> Array:
    """What `smooth` in the examples makes of a ratio."""
    for _ in range(4):
        ratio = box_mean(ratio)
    return ratio


def estimate(parents: PlainParents) -> Array:
    """The estimate before it is drawn towards the samples."""
    given = {name: np.asarray(image, np.float64) for name, image in parents.images().items()}
    traced, splat, albedo = given["traced"], given["splat"], given["albedo"]
    dark = 0.1 * np.sqrt((traced + splat) / 2).mean() ** 2
    level = splat.mean(2, keepdims=True) + dark
    seen = lambda image: image / (image + level)  # noqa: E731
    texture = np.log(albedo + 0.03) - np.log(box_mean(albedo) + 0.03)
    change = seen(splat) * (1 - seen(splat)) * texture
    change[(traced == splat).all(2)] = 0
    lacks = (change * (seen(traced) - seen(splat))).sum() / max((change**2).sum(), 1e-5)
    splat = splat * np.exp(np.clip(lacks - 0.25, 0, 1) * texture)
    ratio = (block_means(traced, 2) + dark / 2) / (block_means(splat, 2) + dark / 2)
    ratio = smoothed(np.minimum(ratio, 100))
    relit = np.maximum(enlarged(ratio, 2, traced.shape) * (splat + dark / 2) - dark / 2, 0)
    estimates = [splat, relit, *([given["denoised"]] if "denoised" in given else [])]
    weights = _shares(given, [seen(image) for image in (traced, *estimates)], parents.expected)
    return sum(enlarged(w, 4, traced.shape) * e for w, e in zip(weights, estimates, strict=True))


def _shares(given: dict[str, Array], seen: list[Array], expected: float) -> list[Array]:
    """Weights (h, w, 1) of the candidates, a quarter of the size, by what is seen of samples and these."""
    traced, splat, relit, *denoised = seen

    def pair(one: Array, other: Array) -> list[Array]:
        way = other - one
        maps = (traced - other) ** 2, way**2, (traced - one) * way
        lacks, apart, along = (box_mean(block_means(m.mean(2, keepdims=True), 4)) for m in maps)
        return [np.log(lacks + 1e-5), np.log(apart + 1e-5), np.clip(along / (apart + 1e-5), -3, 3)]

    channels = pair(splat, relit)
    even = np.ones_like(channels[0])
    channels = [even, *channels]
    if denoised:
        number, earlier = (box_mean(block_means(given[name], 4)) for name in ("count", "earlier"))
        lacks, apart, along = pair(splat, *denoised)
        along = (along - 0.5) * np.log2(np.clip(number, 1, 64))
        channels += [lacks, apart, along, *pair(relit, *denoised)[1:]]
        channels.append(np.minimum(earlier / np.maximum(number, 1), 1))
    else:
        channels.append(even * np.log(np.clip(expected, 1e-5, 1e-2)))
    odds = module.ODDS if denoised else module.QUICK_ODDS
    logits = [0 * channels[0]] + [sum(o * c for o, c in zip(of, channels, strict=True)) for of in odds]
    return list(np.exp(logits) / np.exp(logits).sum(0))


def fused(parents: PlainParents) -> Array:
    """The estimate, drawn towards the samples."""
    made = estimate(parents)
    kept = trust(made, parents.traced, parents.variance, parents.count)[..., None]
    return kept * made + (1 - kept) * parents.traced


def trust(estimate: Array, traced: Array, variance: Array, count: Array) -> Array:
    """(H, W) share that an estimate keeps beside traced radiance."""
    estimate, traced, variance, count = (
        np.asarray(image, np.float64) for image in (estimate, traced, variance, count)
    )
    known = np.isfinite(variance).all(2, keepdims=True)
    explained = np.where(known, variance, 0).mean(2, keepdims=True)
    excess = ((estimate - traced) ** 2).mean(2, keepdims=True) - explained
    level = (estimate @ [[0.2126], [0.7152], [0.0722]]) ** 2 + 1e-8
    maps = block_means(np.concatenate([excess, excess**2, explained, level], 2), 2)
    number = block_means(count, 2)
    small, large = box_mean(maps), enlarged(block_means_around(maps, 4, 4), 4, maps.shape)
    excess, squares, explained, level = np.split(small, 4, 2)
    explained = np.maximum(explained, large[..., 2:3] / large[..., 3:4] * level)
    spread = np.maximum(squares - excess**2, large[..., 1:2] - large[..., 0:1] ** 2)
    error = np.sqrt(np.maximum(spread, 0) / 36)
    error = np.minimum(error, explained * (1.5 + 20 / np.sqrt(number)))
    bias = np.maximum(excess - 2 * error, 0.005**2 * level)
    share = enlarged(explained / (explained + bias + 1e-20), 2, traced.shape)
    return np.where(known, share, 1)[..., 0]
