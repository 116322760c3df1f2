"""Numbers of samples that differ from pixel to pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr


@dataclass(frozen=True)
class Counts:
    """Numbers of samples of D pixels.

    Attributes:
        each: UInt (D,), of each pixel.
        total: of all pixels.
        most: of any pixel, or more.
    """

    each: Any
    total: int
    most: int

    @staticmethod
    def of(each: Any, most: int) -> Counts:
        """The numbers (D,) of pixels; waits for their sum."""
        return Counts(each, int(dr.sum(each)[0]), most)
