"""Rasterizes frames part by part where the pairs of splat and tile would not fit memory.

100,000 splats that each cover 4096 x 4096 pixels are 6.5e9 pairs of splat and tile: more than 32 bits count,
and hundreds of gigabytes. Such a frame is divided into bands of rows of tiles, and where one row is still too
much, into pieces of it. Each part is binned, rasterized and forgotten; the gradient bins it again. Image and
gradients have the same bits as in one pass: a tile's list does not depend on other tiles, and the gradient's
sums over a splat's tiles go through them row by row in either case.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from typing import TYPE_CHECKING

import drjit as dr

from compose.base.arrays import Arrays
from splat.raster.binning import Bins, Candidates, TileWindow
from splat.raster.blending import STANDARD, Compositing, ImageSplit, rasterize, sums_of_bins
from splat.raster.records import Records

if TYPE_CHECKING:
    from drjit.auto.ad import Float

# Candidate pairs that are listed at once; at some 90 bytes each, 1.5 GB.
PAIRS_AT_ONCE = 1 << 24


class Parts:
    """The lists of splats of a frame's tiles: all at once or, if those are too long, part by part.

    Iterating gives the lists of each part, from the top left to the bottom right, as `Bins` for its tiles. A
    single part is kept; several are made anew each time. A part of a single tile is not divided further: its
    list is no longer than the splats are many.
    """

    def __init__(self, candidates: Candidates, rules: Compositing = STANDARD):
        self.grid, self.blended, self._candidates = candidates.grid, candidates.found.blended, candidates
        self.rules = rules
        runs = self._candidates.runs(self._candidates.whole)
        # The single part, if it is one.
        self.only = self._candidates.bins(runs) if runs.pairs <= PAIRS_AT_ONCE else None

    def coloured(self, blended: Records, rules: Compositing) -> Parts:
        """The same lists, of splats in other colours."""
        other = copy(self)
        other.blended, other.rules = blended, rules
        return other

    def __iter__(self) -> Iterator[Bins]:
        if self.only is not None:
            yield self.only
        else:
            yield from self._lists(self._candidates.whole)

    def _lists(self, window: TileWindow) -> Iterator[Bins]:
        runs = self._candidates.runs(window)
        middle_x, middle_y = (window.left + window.right) // 2, (window.top + window.bottom) // 2
        if runs.pairs <= PAIRS_AT_ONCE or (middle_x == window.left and middle_y == window.top):
            if runs.pairs:
                yield self._candidates.bins(runs)
            return
        # Rows first: only then do the parts follow one another as the tiles do.
        if middle_y > window.top:
            halves = window._replace(bottom=middle_y), window._replace(top=middle_y)
        else:
            halves = window._replace(right=middle_x), window._replace(left=middle_x)
        # Not kept while its halves are drawn.
        del runs
        for half in halves:
            yield from self._lists(half)


def rasterize_parts(arrays: Arrays, parts: Parts, heights: Sequence[int] | None = None) -> list[Float]:
    """Renders linear radiance and opacity, as `rasterize` does: images of so many rows of tiles, or one."""
    split = ImageSplit.of(arrays, parts.grid, heights or [parts.grid.rows])
    images = None if parts.only is not None else split.new(arrays, dr.zeros)
    for bins in parts:
        images = rasterize(arrays, parts.blended, bins, split, images, parts.rules)
    assert images is not None
    return images


def sums_of_parts(arrays: Arrays, parts: Parts, image: Float, gradient: Float) -> list[Float]:
    """The (N,) sums that gradients by the splats are made of, from the gradient by an image."""
    sums = None
    for bins in parts:
        sums = sums_of_bins(arrays, parts.blended, bins, image, gradient, sums, parts.rules)
    assert sums is not None
    return sums
