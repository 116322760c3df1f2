"""Samples of some pixels of a view, how those of two passes are merged, and records of their sums.

A record is sixteen floats of a pixel, loaded at once: the number of samples, three sums of their radiance,
three of its squares; the number of sample positions whose auxiliary features are known, three sums of their
albedo, three of their normals; and two zeros. Here, N records are a list of sixteen Floats (N,).

Sums of squares beyond float32 are inf. Sums of radiance beyond it, which takes several samples near the
largest float, count as the largest float.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

# Floats of a record, and which of them are what.
RECORD = 16
COUNT, RADIANCE, SQUARES = 0, slice(1, 4), slice(4, 7)
POSITIONS, ALBEDO, NORMAL = 7, slice(8, 11), slice(11, 14)
# Makes 0 of 0 / 0.
_NOTHING = 1e-6
_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Samples:
    """Samples of D pixels of one view, as Dr.Jit arrays of width D; lists have three of them."""

    pixels: UInt  # row-major indices, each once
    count: Float  # samples in each; 0 where only the auxiliary features are known
    radiance: list[Float]  # their mean, linear
    squares: list[Float]  # mean of their squares; inf where these are beyond float32
    albedo: list[Float]  # mean over sample positions in the pixel, as the normal
    normal: list[Float]
    position: list[Float]  # in the world, where one of the samples appears to hit; far away for sky
    gloss: Float  # DIFFUSE, GLOSSY or SPECULAR (compose.base.traced_samples), of what it hits
    mover: Float  # number of what it hits among what moves; 0 if that stands still
    earlier: Float  # how many of the samples were reprojected from earlier views

    @staticmethod
    def none(arrays: Arrays, pixels: UInt) -> Samples:
        """Pixels about which nothing is known."""
        nothing = dr.zeros(arrays.plain.Float, dr.width(pixels))
        triple = [nothing] * 3
        return Samples(pixels, nothing, triple, triple, triple, triple, triple, nothing, nothing, nothing)

    @property
    def size(self) -> int:
        """D, the number of pixels."""
        return dr.width(self.pixels)

    def variance(self) -> list[Float]:
        """Of the mean radiance; inf where it is unknown: one sample, or squares beyond float32."""
        if not self.size:
            # Dr.Jit refuses arithmetic with arrays of width 0.
            return self.squares
        found = []
        for mean, square in zip(self.radiance, self.squares, strict=True):
            spread = dr.maximum(square - dr.square(mean), 0) / dr.maximum(self.count - 1, _NOTHING)
            found.append(dr.select((self.count > 1) & dr.isfinite(square), spread, dr.inf))
        return found

    def mean_count(self) -> float:
        """Samples per pixel on average; 0 without a pixel."""
        return float(dr.mean(self.count)[0]) if self.size else 0.0


def merged(one: Samples, other: Samples) -> Samples:
    """The light of two sets of samples of the same pixels together; everything else is the first one's."""
    count = one.count + other.count
    share = other.count / dr.maximum(count, _NOTHING)
    radiance, squares = (
        _mixed(*of, share) for of in ((one.radiance, other.radiance), (one.squares, other.squares))
    )
    return replace(one, count=count, radiance=radiance, squares=squares)


def averaged_features(one: Samples, other: Samples, share: Float) -> Samples:
    """The first samples, with albedo and normal averaged over both; `share` (D,) is the other's."""
    albedo, normal = (_mixed(*of, share) for of in ((one.albedo, other.albedo), (one.normal, other.normal)))
    return replace(one, albedo=albedo, normal=normal)


def _mixed(one: list[Float], other: list[Float], share: Float) -> list[Float]:
    """Channels of which a share is the other's; 0 and 1 leave infinities alone."""
    found = []
    for a, b in zip(one, other, strict=True):
        mean = dr.select(share >= 1, b, a * (1 - share) + b * share)
        found.append(dr.select(share <= 0, a, mean))
    return found


def taken(samples: Samples, chosen: UInt) -> Samples:
    """Some of the pixels, by their indices (M,) among the D."""
    return Samples(*dr.gather(list, list(vars(samples).values()), chosen))


def put(samples: Samples, chosen: UInt, part: Samples) -> Samples:
    """The samples with others in place of some pixels, by their indices (M,) among the D."""
    values = dr.copy(list(vars(samples).values()))
    dr.scatter(values, list(vars(part).values()), chosen, mode=dr.ReduceMode.Permute)
    return Samples(*values)


def with_light(records: list[Float], samples: Samples) -> list[Float]:
    """Records (D,) with the light of samples added."""
    light = zip(records[1:POSITIONS], [*samples.radiance, *samples.squares], strict=True)
    sums = [dr.fma(samples.count, more, own) for own, more in light]
    return [records[COUNT] + samples.count, *sums, *records[POSITIONS:]]


def with_features(records: list[Float], samples: Samples, positions: Float) -> list[Float]:
    """Records (D,) with auxiliary features added, means over a number of sample positions."""
    features = zip(records[ALBEDO.start : NORMAL.stop], [*samples.albedo, *samples.normal], strict=True)
    sums = [own + more * positions for own, more in features]
    return [*records[:POSITIONS], records[POSITIONS] + positions, *sums, *records[NORMAL.stop :]]


def means(records: list[Float]) -> tuple[Float, list[Float], list[Float], list[Float], list[Float]]:
    """Counts (D,), and three Floats (D,) each: means of radiance, squares, albedo and normal."""
    by_count, by_positions = (1 / dr.maximum(records[of], _NOTHING) for of in (COUNT, POSITIONS))
    radiance = [dr.minimum(total, _LARGEST) * by_count for total in records[RADIANCE]]
    squares = [total * by_count for total in records[SQUARES]]
    albedo, normal = ([total * by_positions for total in records[part]] for part in (ALBEDO, NORMAL))
    return records[COUNT], radiance, squares, albedo, normal


def limited(records: list[Float], most: float) -> list[Float]:
    """Records (D,) that stand for more samples or sample positions than `most` scaled down to it."""
    light, features = (dr.minimum(most / dr.maximum(records[of], _NOTHING), 1) for of in (COUNT, POSITIONS))
    return (
        [own * light for own in records[:POSITIONS]]
        + [own * features for own in records[POSITIONS : NORMAL.stop]]
        + records[NORMAL.stop :]
    )
