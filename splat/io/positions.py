"""Positions in 16 bits per axis, between the corners of boxes around few nodes.

Nodes of a layer lie along a space-filling curve, so that boxes around those that follow each other are small.
They are made smaller until their steps are finer than what they hold; the box of a single node is a point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splat.io.rounding import Codes
from splat.model.rows import Floats, Ints

_STEPS = 2**16 - 1
_LARGEST_BOX = 256
# A node's position is right to this share of its shortest axis. Of one as flat as a sheet, a share of its
# longest axis: then, what fills a hundred pixels moves by a tenth of one.
_OF_SHORTEST, _OF_LONGEST = 1 / 16, 1 / 1024


@dataclass(frozen=True)
class Boxes:
    """B boxes around the N nodes of a forest, in their order.

    Attributes:
        counts: (B,) int32, nodes in each.
        low, high: (3, B) float32 corners.
        codes: (3, N) int16, of each node the steps from low to high, unsigned.
    """

    counts: Codes
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    codes: Codes


def tolerance(log_scales: Floats) -> Floats:
    """(N,) furthest that a node may be moved, from logarithms of its axes (3, N)."""
    return np.maximum(
        _OF_SHORTEST * np.exp(log_scales.min(axis=0)), _OF_LONGEST * np.exp(log_scales.max(axis=0))
    )


def boxed(means: Floats, tolerated: Floats, layers: tuple[int, ...]) -> Boxes:
    """Encodes positions.

    Args:
        means: (3, N), numbers of float32.
        tolerated: (N,) furthest that each may be moved, apart from float32's own rounding.
        layers: nodes per layer; no box holds nodes of two.
    """
    first = _firsts(means, tolerated, layers)
    counts = np.diff(np.r_[first, means.shape[1]])
    low, high = _corners(means, first)
    wide, from_low = (np.repeat(part, counts, axis=1) for part in (high - low, low))
    share = (means - from_low) / np.where(wide > 0, wide, 1)
    codes = np.rint(share * _STEPS).astype(np.uint16).view(np.int16)
    return Boxes(counts.astype(np.int32), low.astype(np.float32), high.astype(np.float32), codes)


def unboxed(boxes: Boxes) -> Floats:
    """Positions (3, N), within the tolerance of what was encoded, corners exactly.

    Raises:
        ValueError: the boxes do not hold as many nodes as there are codes.
    """
    counts = boxes.counts.astype(np.int64)
    if (counts < 1).any() or counts.sum() != boxes.codes.shape[1]:
        raise ValueError("boxes that do not hold all positions")
    low, high = (np.repeat(part.astype(np.float64), counts, axis=1) for part in (boxes.low, boxes.high))
    share = boxes.codes.view(np.uint16) / _STEPS
    return low * (1 - share) + high * share


def _firsts(means: Floats, tolerated: Floats, layers: tuple[int, ...]) -> Ints:
    """(B,) index of the first node of each box: halves of halves until all are small enough."""
    ends = np.cumsum(layers)
    starts = [np.arange(end - n, end, _LARGEST_BOX) for end, n in zip(ends, layers, strict=True)]
    first = np.concatenate(starts).astype(np.int64)
    while len(first):
        counts = np.diff(np.r_[first, means.shape[1]])
        low, high = _corners(means, first)
        error = np.linalg.norm((high - low) / (2 * _STEPS), axis=0)
        coarse = (error > np.minimum.reduceat(tolerated, first)) & (counts > 1)
        if not coarse.any():
            break
        first = np.sort(np.r_[first, (first + counts // 2)[coarse]])
    return first


def _corners(means: Floats, first: Ints) -> tuple[Floats, Floats]:
    """(3, B) lowest and highest coordinates of nodes (3, N) from each index (B,) up to the next one."""
    if not len(first):
        return np.zeros((3, 0)), np.zeros((3, 0))
    return np.minimum.reduceat(means, first, axis=1), np.maximum.reduceat(means, first, axis=1)
