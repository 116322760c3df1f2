"""Names of the ways to trace paths."""

from __future__ import annotations

from enum import Enum


class Integrator(Enum):
    """How radiance is estimated.

    Attributes:
        PATH: Mitsuba's path tracer; unbiased.
        CACHED: paths that end in a cache of irradiance; a fraction of the noise in less time, but biased.
    """

    PATH = "path"
    CACHED = "cached"

    @property
    def is_unbiased(self) -> bool:
        """Whether the mean over many samples is the truth."""
        return self is Integrator.PATH
