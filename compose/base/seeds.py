"""Seeds of random numbers."""

from __future__ import annotations

import operator
from typing import Any

from compose.base.errors import UserError

# The largest integer of 64 bits: what seeds are saved as.
MOST_SEED = (1 << 63) - 1


def require_seed(seed: Any) -> int:
    """Checks a seed before any work.

    Raises:
        UserError: it is not a whole number from 0 to MOST_SEED.
    """
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if not 0 <= number <= MOST_SEED:
        raise UserError(f"seed {seed}: must be a whole number from 0 to {MOST_SEED}")
    return number
