"""Samples of some pixels of a view, how those of two passes are merged, and records of their sums.

Records are sums over a pixel's samples, as they are stored, reprojected and added up. A record is sixteen
floats: the number of samples, three sums of their radiance, three of its squares; the number of sample
positions whose auxiliary features are known, three sums of their albedo, three of their normals; and two
zeros. Kernels load it at once. Here, N records are a list of sixteen Floats (N,).

Sums of squares beyond float32 are inf. Sums of radiance beyond it, which takes several samples near the
largest float, count as the largest float.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays

# Floats of a record, and which of them are what.
RECORD = 16
COUNT, RADIANCE, SQUARES = 0, slice(1, 4), slice(4, 7)
POSITIONS, ALBEDO, NORMAL = 7, slice(8, 11), slice(11, 14)
# Makes 0 of 0 / 0.
_NOTHING = 1e-6
_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Samples:
    """Samples of D pixels of one view, as Dr.Jit arrays of width D.

    Attributes:
        pixels: UInt, row-major indices, each once.
        count: Float, samples in each; 0 where only the auxiliary features are known.
        radiance: three Floats, their mean, linear.
        squares: three Floats, mean of their squares; inf where these are beyond float32.
        albedo, normal: three Floats each, means over sample positions in the pixel.
        position: three Floats, in the world, where one of the samples appears to hit something; far away for
            sky.
        gloss: Float, DIFFUSE, GLOSSY or SPECULAR (compose.base.traced_samples), of what it hits.
        mover: Float, number of what it hits among what moves; 0 if that stands still.
    """

    pixels: Any
    count: Any
    radiance: list[Any]
    squares: list[Any]
    albedo: list[Any]
    normal: list[Any]
    position: list[Any]
    gloss: Any
    mover: Any

    @staticmethod
    def none(arrays: Arrays, pixels: Any) -> Samples:
        """Pixels about which nothing is known."""
        nothing = dr.zeros(arrays.plain.Float, dr.width(pixels))
        triple = [nothing] * 3
        return Samples(pixels, nothing, triple, triple, triple, triple, triple, nothing, nothing)

    @property
    def size(self) -> int:
        """D, the number of pixels."""
        return dr.width(self.pixels)

    def variance(self) -> list[Any]:
        """Three Floats, variance of the mean radiance; inf where it is unknown.

        One sample alone cannot tell, and neither can those whose squares are beyond float32.
        """
        if not self.size:
            # Dr.Jit refuses arithmetic with arrays of width 0.
            return self.squares
        found = []
        for mean, square in zip(self.radiance, self.squares, strict=True):
            spread = dr.maximum(square - dr.square(mean), 0) / dr.maximum(self.count - 1, 1e-6)
            found.append(dr.select((self.count > 1) & dr.isfinite(square), spread, dr.inf))
        return found

    def mean_count(self) -> float:
        """Samples per pixel on average; 0 without a pixel."""
        return float(dr.mean(self.count)[0]) if self.size else 0.0


def merged(one: Samples, other: Samples) -> Samples:
    """The light of two sets of samples of the same pixels together; everything else is the first one's."""
    count = one.count + other.count
    share = other.count / dr.maximum(count, 1e-6)
    return replace(_mixed(one, other, share, "radiance", "squares"), count=count)


def averaged_features(one: Samples, other: Samples, share: Any) -> Samples:
    """The first samples, with albedo and normal averaged over both; `share` (D,) is the other's."""
    return _mixed(one, other, share, "albedo", "normal")


def _mixed(one: Samples, other: Samples, share: Any, *names: str) -> Samples:
    """The first samples, of whose named channels a share is the other's; 0 and 1 leave infinities alone."""
    mean = lambda a, b: dr.select(share <= 0, a, dr.select(share >= 1, b, a * (1 - share) + b * share))  # noqa: E731
    return replace(one, **{name: list(map(mean, getattr(one, name), getattr(other, name))) for name in names})


def taken(samples: Samples, chosen: Any) -> Samples:
    """Some of the pixels, by their indices (M,) among the D."""
    return _each(samples, lambda values: dr.gather(type(values), values, chosen))


def put(samples: Samples, chosen: Any, part: Samples) -> Samples:
    """The samples with others in place of some pixels, by their indices (M,) among the D."""

    def replaced(values: Any, others: Any) -> Any:
        copy = type(values)(values)
        dr.scatter(copy, others, chosen, mode=dr.ReduceMode.Permute)
        return copy

    return _each(samples, replaced, part)


def _each(samples: Samples, function: Any, *others: Samples) -> Samples:
    """Samples whose arrays are what a function makes of those of some samples."""
    found = {}
    for field in fields(Samples):
        values, *more = (getattr(of, field.name) for of in (samples, *others))
        if isinstance(values, list):
            found[field.name] = [function(*channels) for channels in zip(values, *more, strict=True)]
        else:
            found[field.name] = function(values, *more)
    return Samples(**found)


def with_light(records: list[Any], samples: Samples) -> list[Any]:
    """Records (D,) with the light of samples added."""
    light = zip(records, [1, *samples.radiance, *samples.squares], strict=False)
    return [dr.fma(samples.count, more, own) for own, more in light] + records[POSITIONS:]


def with_features(records: list[Any], samples: Samples, positions: Any) -> list[Any]:
    """Records (D,) with auxiliary features added, means over a number of sample positions."""
    features = zip(records[POSITIONS:], [1, *samples.albedo, *samples.normal], strict=False)
    return records[:POSITIONS] + [own + more * positions for own, more in features] + records[NORMAL.stop :]


def means(records: list[Any]) -> tuple[Any, list[Any], list[Any], list[Any], list[Any]]:
    """Counts (D,), and three Floats (D,) each: means of radiance, squares, albedo and normal."""
    by_count, by_positions = (1 / dr.maximum(records[of], _NOTHING) for of in (COUNT, POSITIONS))
    radiance = [dr.minimum(total, _LARGEST) * by_count for total in records[RADIANCE]]
    squares = [total * by_count for total in records[SQUARES]]
    albedo, normal = ([total * by_positions for total in records[part]] for part in (ALBEDO, NORMAL))
    return records[COUNT], radiance, squares, albedo, normal


def limited(records: list[Any], most: float) -> list[Any]:
    """Records (D,) that stand for more samples or sample positions than `most` scaled down to it."""
    light, features = (dr.minimum(most / dr.maximum(records[of], _NOTHING), 1) for of in (COUNT, POSITIONS))
    return (
        [own * light for own in records[:POSITIONS]]
        + [own * features for own in records[POSITIONS : NORMAL.stop]]
        + records[NORMAL.stop :]
    )
