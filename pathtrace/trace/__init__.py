"""Names of the ways to trace paths."""

from __future__ import annotations

from enum import Enum

from compose.base.errors import UserError


class Integrator(Enum):
    """How radiance is estimated."""

    # Mitsuba's path tracer; unbiased.
    PATH = "path"
    # Paths that end in a cache of irradiance; a fraction of the noise in less time, but biased.
    CACHED = "cached"

    @property
    def is_unbiased(self) -> bool:
        """Whether the mean over many samples is the truth."""
        return self is Integrator.PATH


def integrator_named(given: Integrator | str) -> Integrator:
    """The integrator of a name; UserError if there is none."""
    try:
        return Integrator(given)
    except ValueError as error:
        names = " or ".join(one.value for one in Integrator)
        raise UserError(f"integrator {given}: must be {names}") from error
