"""The order in which views are trained on: the more often, the more is wrong in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Of an average view's share, what every view gets whatever its error, which others may make larger meanwhile.
_FLOOR = 0.25


def order_of_views(errors: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int64]:
    """(V,) views of a round of V steps, in random order; a view may be among them several times, or not.

    How often differs by less than 1 from what is in proportion to its error and a floor.

    Args:
        errors: (V,) latest error of each view; NaN where it is not known, which counts as average.
        rng: shuffles them.
    """
    count = len(errors)
    known = errors[np.isfinite(errors)]
    average = known.mean() if len(known) and known.mean() > 0 else 1.0
    weights = np.where(np.isfinite(errors), errors, average) + _FLOOR * average
    views = rng.permutation(count)
    # Systematic sampling: evenly spaced marks on the weights laid end to end.
    ends = np.cumsum(weights[views])
    marks = (np.arange(count) + rng.random()) * (ends[-1] / count)
    return rng.permutation(views[np.minimum(np.searchsorted(ends, marks, side="right"), count - 1)])
