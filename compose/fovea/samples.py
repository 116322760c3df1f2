"""Samples of some pixels of a view, and how to put those of two passes together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

DIFFUSE, GLOSSY, SPECULAR = 0, 1, 2


@dataclass(frozen=True)
class Samples:
    """Samples of D pixels of one view.

    Attributes:
        pixels: (D,) row-major indices, each once.
        count: (D,) samples in each; 0 where only the auxiliary features are known.
        radiance: (D, 3) their mean, linear.
        squares: (D, 3) mean of their squares.
        albedo, normal: (D, 3) means over places in the pixel.
        position: (D, 3) in the world, where what is seen in one of them seems to be; far away if the sky.
        gloss: (D,) DIFFUSE, GLOSSY or SPECULAR, of that.
    """

    pixels: NDArray[np.uint32]
    count: Array
    radiance: Array
    squares: Array
    albedo: Array
    normal: Array
    position: Array
    gloss: NDArray[np.uint8]

    def variance(self) -> Array:
        """(D, 3) of the mean radiance; inf where one sample does not tell."""
        count = self.count[:, None]
        spread = np.maximum(self.squares - self.radiance**2, 0)
        with np.errstate(divide="ignore"):
            return np.where(count > 1, spread / np.maximum(count - 1, 1e-6), np.inf).astype(np.float32)


def merged(one: Samples, other: Samples) -> Samples:
    """Light of two sets of samples of the same pixels in one; everything else is the first's."""
    if not one.count.any():
        return replace(one, count=other.count, radiance=other.radiance, squares=other.squares)
    count = one.count + other.count
    share = (other.count / np.maximum(count, 1e-6))[:, None]
    mean = lambda name: getattr(one, name) * (1 - share) + getattr(other, name) * share  # noqa: E731
    return replace(one, count=count, radiance=mean("radiance"), squares=mean("squares"))
