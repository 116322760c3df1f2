"""The window of the structural similarity, as kernels over images with interleaved channels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays

TAPS = 11
_SIGMA = 1.5
_offsets = np.arange(TAPS) - TAPS // 2
_gaussian = np.exp(-(_offsets**2) / (2 * _SIGMA**2))
# Gaussian window of 11 taps with a sum of 1 (Wang et al. 2004).
WEIGHTS: list[float] = (_gaussian / _gaussian.sum()).tolist()
CHANNELS = 3
# Neighbouring results that one lane computes: together they read 18 pixels, one by one 88.
_RUN = 8


@dataclass(frozen=True)
class Axis:
    """Where the window moves: along the rows or along the columns of an image.

    Attributes:
        lines: rows or columns that it moves along.
        before, after: pixels of each line before and after.
        is_horizontal: whether the lines are rows.
        padding: pixels of zeros that are added at both ends of each line first.
    """

    lines: int
    before: int
    after: int
    is_horizontal: bool
    padding: int

    @property
    def runs(self) -> int:
        """Lanes per line."""
        return -(-self.after // _RUN)

    def sizes(self, arrays: Arrays) -> list[Any]:
        """Pixels per line before and after, lanes per line, and floats per line, read from memory.

        The same kernels serve images of all sizes.
        """
        return [arrays.constant(n) for n in (self.before, self.after, self.runs, self.lines * CHANNELS)]


def across(width: int, height: int) -> Axis:
    """Along the rows of an image, over the valid region."""
    return Axis(height, width, width - TAPS + 1, True, 0)


def down(width: int, height: int) -> Axis:
    """Along the columns of an image, over the valid region."""
    return Axis(width, height, height - TAPS + 1, False, 0)


def transposed(axis: Axis) -> Axis:
    """What takes derivatives by the results to derivatives by the pixels: the window is symmetric."""
    return Axis(axis.lines, axis.after, axis.before, axis.is_horizontal, TAPS - 1)


def blur(
    arrays: Arrays,
    axis: Axis,
    sizes: list[Any],
    load: Callable[[Any, Any], Sequence[Any]],
    finish: Callable[[Any, list[Any]], Sequence[Any]] = lambda index, sums: sums,
) -> list[Any]:
    """Applies the window along one axis to several maps at once.

    Args:
        arrays: the backend's array types.
        axis: where.
        sizes: those of the axis; recorded functions take them as arguments.
        load: the maps' numbers at an index into an image of `before` pixels per line, under a mask.
        finish: what is stored at an index into the result, from the maps' blurred numbers there.

    Returns:
        What `finish` gave, each flat, `after` pixels per line.
    """
    Float, UInt, Int = arrays.plain.Float, arrays.plain.UInt, arrays.plain.Int
    lane = dr.arange(UInt, axis.runs * axis.lines * CHANNELS)
    before, after, across_runs, stride = sizes
    if axis.is_horizontal:
        rest, channel = lane // CHANNELS, lane % CHANNELS
        line = rest // across_runs
        first, stride = (rest - line * across_runs) * _RUN, UInt(CHANNELS)
        start_in, start_out = line * before * CHANNELS + channel, line * after * CHANNELS + channel
    else:
        run = lane // stride
        first, start_in = run * _RUN, lane - run * stride
        start_out = start_in
    columns = []
    for k in range(_RUN + TAPS - 1):
        position = Int(first) + (k - axis.padding)
        inside = (position >= 0) & (position < Int(before))
        columns.append(load(start_in + UInt(dr.maximum(position, 0)) * stride, inside))
    size = axis.lines * axis.after * CHANNELS
    results: list[Any] = []
    for r in range(_RUN):
        sums = []
        for values in zip(*columns[r : r + TAPS], strict=True):
            total = values[0] * WEIGHTS[0]
            for value, weight in zip(values[1:], WEIGHTS[1:], strict=True):
                total = dr.fma(value, weight, total)
            sums.append(total)
        inside = first + r < after
        index = dr.select(inside, start_out + (first + r) * stride, 0)
        stored = finish(index, sums)
        results = results or [dr.empty(Float, size) for _ in stored]
        for result, value in zip(results, stored, strict=True):
            dr.scatter(result, value, index, inside, mode=dr.ReduceMode.Permute)
    dr.eval(results)
    return results
