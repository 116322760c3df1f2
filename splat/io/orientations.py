"""Quaternions in 33 bits: three components over the largest one, in steps of 1/511.

Unlike with the three smallest of a unit quaternion, what is decoded encodes to the same codes, also where two
components are equally large. Signs are kept: a learned field of deformations adds to quaternions.
"""

from __future__ import annotations

import numpy as np

from splat.io.rounding import Codes
from splat.model.rows import Floats, Ints

_STEPS = 511


def codes_of_rotations(quaternions: Floats) -> tuple[Codes, Codes]:
    """Codes of quaternions (4, N) of any length; that of length 0, which turns nothing, becomes (1, 0, 0, 0).

    Returns:
        (N,) uint8, which component is the largest, plus 4 if it is negative; and (3, N) int16, the others
        over it.
    """
    largest = np.abs(quaternions).max(axis=0)
    turned = np.where(largest > 0, quaternions, np.array([[1.0], [0], [0], [0]]))
    steps = np.rint(turned / np.where(largest > 0, largest, 1) * _STEPS).astype(np.int16)
    # Of components that are equally large after rounding, the first one.
    index = (np.abs(steps) == _STEPS).argmax(axis=0)[None]
    sign = np.sign(np.take_along_axis(steps, index, axis=0))
    others = np.take_along_axis(steps * sign, _others(index[0]), axis=0)
    return (index + 4 * (sign < 0))[0].astype(np.uint8), others


def rotations_of_codes(largest: Codes, others: Codes) -> Floats:
    """Quaternions (4, N), turned by at most 0.2 degrees, whose largest component is 1 or -1.

    Raises:
        ValueError: there is no such component, or another one is larger.
    """
    if len(largest) and (largest.max() >= 8 or np.abs(others.astype(np.int32)).max() > _STEPS):
        raise ValueError("rotations with codes that do not exist")
    index, sign = (largest % 4).astype(np.int64), np.where(largest >= 4, -1.0, 1.0)
    quaternions = np.empty((4, len(largest)))
    np.put_along_axis(quaternions, index[None], sign[None], axis=0)
    np.put_along_axis(quaternions, _others(index), sign * others / _STEPS, axis=0)
    return quaternions


def _others(index: Ints) -> Ints:
    """(3, N) the components besides those at an index (N,)."""
    others = np.arange(3)[:, None]
    return others + (others >= index)
