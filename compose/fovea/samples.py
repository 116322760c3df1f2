"""Samples of some pixels of a view, and how those of two passes are merged."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Samples:
    """Samples of D pixels of one view.

    Attributes:
        pixels: (D,) row-major indices, each once.
        count: (D,) samples in each; 0 where only the auxiliary features are known.
        radiance: (D, 3) their mean, linear.
        squares: (D, 3) mean of their squares; inf where these are beyond float32.
        albedo, normal: (D, 3) means over sample positions in the pixel.
        position: (D, 3) in the world, where one of the samples appears to hit something; far away for sky.
        gloss: (D,) DIFFUSE, GLOSSY or SPECULAR (compose.image.gloss), of what it hits.
        mover: (D,) number of what it hits among what moves (compose.fovea.movers); 0 if that stands still.
    """

    pixels: NDArray[np.uint32]
    count: Floats
    radiance: Floats
    squares: Floats
    albedo: Floats
    normal: Floats
    position: Floats
    gloss: NDArray[np.uint8]
    mover: NDArray[np.uint16]

    def variance(self) -> Floats:
        """(D, 3) variance of the mean radiance; inf where it is unknown.

        One sample alone cannot tell, and neither can those whose squares are beyond float32.
        """
        count = self.count[:, None]
        known = (count > 1) & np.isfinite(self.squares)
        with np.errstate(over="ignore", invalid="ignore"):
            spread = np.maximum(self.squares - self.radiance**2, 0)
        return np.where(known, spread / np.maximum(count - 1, 1e-6), np.inf).astype(np.float32)


def merged(one: Samples, other: Samples) -> Samples:
    """The light of two sets of samples of the same pixels together; everything else is the first one's."""
    if not one.count.any():
        return replace(one, count=other.count, radiance=other.radiance, squares=other.squares)
    count = one.count + other.count
    share = (other.count / np.maximum(count, 1e-6))[:, None]
    mean = lambda name: getattr(one, name) * (1 - share) + getattr(other, name) * share  # noqa: E731
    return replace(one, count=count, radiance=mean("radiance"), squares=mean("squares"))


def averaged_features(one: Samples, other: Samples, share: Floats) -> Samples:
    """The first samples, with albedo and normal averaged over both; `share` (D,) is the other's."""
    part = share[:, None]
    mean = lambda name: getattr(one, name) * (1 - part) + getattr(other, name) * part  # noqa: E731
    return replace(one, albedo=mean("albedo"), normal=mean("normal"))


def taken(samples: Samples, chosen: NDArray[np.int64]) -> Samples:
    """Some of the pixels, by their indices among the D."""
    return Samples(*(getattr(samples, field.name)[chosen] for field in fields(Samples)))


def put(samples: Samples, chosen: NDArray[np.int64], part: Samples) -> Samples:
    """The samples with others in place of some pixels, by their indices among the D."""
    replaced = {}
    for field in fields(Samples):
        replaced[field.name] = getattr(samples, field.name).copy()
        replaced[field.name][chosen] = getattr(part, field.name)
    return Samples(**replaced)
