"""Fewer paths in the band: samples in proportion to the weight that they are shown with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compose.fovea.region import FoveaRegion

# Steps to the next column and row, in 2 ** -32, of a dither mask without clumps or stripes: the golden
# ratio's counterpart in the plane (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
_ACROSS, _DOWN = np.uint32(3242174889), np.uint32(2447445414)


def thinned(region: FoveaRegion, spp: int, seed: int) -> tuple[FoveaRegion, NDArray[np.int64]]:
    """The pixels of a plan that get samples, with the weights of these, and how many each gets.

    On the mean over seeds, the blend is that of the plan itself. A pixel with weight w and n samples of
    variance v has noise of variance w^2 v / n, which over all pixels is least, for as many samples, with n in
    proportion to w (Neyman 1934): spp w. Rounding that to a whole number is left to chance, but evenly over
    the picture; a sample that stands for less than one weighs as much as if it were the only one of spp, and
    where there is none the splats are seen. So no pixel of the band is noisier than those inside of it, as
    long as both pictures agree.

    Args:
        plan: of the whole disc.
        spp: samples per pixel where the weight is 1.
        seed: of the rounding.

    Returns:
        The plan of those pixels, and (D,) how many samples each gets, at least 1.
    """
    counts = np.full(len(region.pixels), spp, dtype=np.int64)
    band = np.flatnonzero(region.weights < 1)
    if not len(band):
        return region, counts
    row, column = np.divmod(region.pixels[band], np.uint32(region.width))
    start = np.uint32(np.random.SeedSequence(seed).generate_state(1)[0])
    # Wraps around, on purpose: what counts is where in 0..1 that ends.
    mask = (column * _ACROSS + row * _DOWN + start).astype(np.float64) * 2.0**-32
    counts[band] = np.floor(spp * region.weights[band].astype(np.float64) + mask).astype(np.int64)
    kept = counts > 0
    weights = np.maximum(region.weights[kept], np.float32(1 / spp))
    return replace(region, pixels=region.pixels[kept], weights=weights), counts[kept]
