"""Arrays whose place in memory is the same for all kernels."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray


def aligned(*arrays: NDArray[Any]) -> list[Any]:
    """Values as flat Dr.Jit arrays in memory of Dr.Jit's own.

    An array that shares NumPy's memory lies anywhere, and kernels are compiled for where their arrays lie:
    with new values, a frozen function might be recorded again.
    """
    copies = []
    for values in arrays:
        shared = mi.Float(np.ascontiguousarray(values, dtype=np.float32).ravel())
        own = dr.empty(mi.Float, len(shared))
        dr.scatter(own, shared, dr.arange(mi.UInt32, len(shared)))
        copies.append(own)
    dr.eval(copies)
    return copies
