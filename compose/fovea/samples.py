"""Samples of some pixels of a view, and how those of two passes are merged; all on the device."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays


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
        gloss: Float, DIFFUSE, GLOSSY or SPECULAR (compose.image.gloss), of what it hits.
        mover: Float, number of what it hits among what moves (compose.fovea.movers); 0 if that stands still.
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

    def numpy(self, name: str) -> NDArray[Any]:
        """(D,) or (D, 3) host array of an attribute or of the variance."""
        values = self.variance() if name == "variance" else getattr(self, name)
        if not isinstance(values, list):
            return np.array(values)
        return np.stack([np.asarray(channel) for channel in values], axis=-1)


def merged(one: Samples, other: Samples) -> Samples:
    """The light of two sets of samples of the same pixels together; everything else is the first one's."""
    count = one.count + other.count
    share = other.count / dr.maximum(count, 1e-6)
    mean = lambda name: _mixed(getattr(one, name), getattr(other, name), share)  # noqa: E731
    return replace(one, count=count, radiance=mean("radiance"), squares=mean("squares"))


def averaged_features(one: Samples, other: Samples, share: Any) -> Samples:
    """The first samples, with albedo and normal averaged over both; `share` (D,) is the other's."""
    mean = lambda name: _mixed(getattr(one, name), getattr(other, name), share)  # noqa: E731
    return replace(one, albedo=mean("albedo"), normal=mean("normal"))


def _mixed(one: list[Any], other: list[Any], share: Any) -> list[Any]:
    """Channels of which a share is the other's; the whole of either is as it was, infinities included."""
    return [
        dr.select(share <= 0, a, dr.select(share >= 1, b, a * (1 - share) + b * share))
        for a, b in zip(one, other, strict=True)
    ]


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
