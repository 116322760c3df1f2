"""Fewer samples in the band: each pixel gets them in proportion to its weight in the blend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compose.fovea.region import FoveaRegion

# Steps of a dither mask per column and row, in units of 2 ** -32, that leave no clumps or stripes: the
# golden ratio's counterpart in the plane (Roberts 2018, "The unreasonable effectiveness of quasirandom
# sequences").
_ACROSS, _DOWN = np.uint32(3242174889), np.uint32(2447445414)


def thinned(region: FoveaRegion, spp: int, seed: int) -> tuple[FoveaRegion, NDArray[np.int64]]:
    """The pixels of a region that get samples, with adjusted weights, and how many samples each gets.

    Averaged over seeds, the blend is that of the whole region. A pixel with weight w and n samples of
    variance v has noise of variance w^2 v / n. For a given number of samples the sum of this over all pixels
    is least with n in proportion to w (Neyman 1934): n = spp w. It is rounded to a whole number at random,
    but evenly over the image. A pixel that is due less than one sample has weight 1 / spp if it gets one, and
    shows the splats if it does not. So no pixel of the band is noisier than those inside it, as long as both
    images agree.

    Args:
        region: the whole disc.
        spp: samples per pixel where the weight is 1.
        seed: of the rounding.

    Returns:
        The region of the pixels that get samples, and (D,) how many each gets, at least 1.
    """
    counts = np.full(len(region.pixels), spp, dtype=np.int64)
    band = np.flatnonzero(region.weights < 1)
    if not len(band):
        return region, counts
    row, column = np.divmod(region.pixels[band], np.uint32(region.width))
    start = np.uint32(np.random.SeedSequence(seed).generate_state(1)[0])
    # The sum wraps around on purpose: only its fractional part counts.
    mask = (column * _ACROSS + row * _DOWN + start).astype(np.float64) * 2.0**-32
    counts[band] = np.floor(spp * region.weights[band].astype(np.float64) + mask).astype(np.int64)
    kept = counts > 0
    weights = np.maximum(region.weights[kept], np.float32(1 / spp))
    return replace(region, pixels=region.pixels[kept], weights=weights), counts[kept]
