"""Fewer samples in the band: each pixel gets them in proportion to its weight in the blend."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np

from compose.fovea.counts import Counts
from compose.fovea.disc import Disc

# Steps of a dither mask per column and row, in units of 2 ** -32, that leave no clumps or stripes: the
# golden ratio's counterpart in the plane (Roberts 2018, "The unreasonable effectiveness of quasirandom
# sequences").
_ACROSS, _DOWN = 3242174889, 2447445414


def thinned(disc: Disc, spp: int, seed: int) -> tuple[Disc, int | Counts]:
    """The pixels of a disc that get samples, with adjusted weights, and how many samples each gets.

    Averaged over seeds, the blend is that of the whole disc. A pixel with weight w and n samples of variance
    v has noise of variance w^2 v / n. For a given number of samples the sum of this over all pixels is least
    with n in proportion to w (Neyman 1934): n = spp w. It is rounded to a whole number at random, but evenly
    over the image. A pixel that is due less than one sample has weight 1 / spp if it gets one, and shows the
    splats if it does not. So no pixel of the band is noisier than those inside it, as long as both images
    agree.

    Args:
        disc: the whole disc.
        spp: samples per pixel where the weight is 1.
        seed: of the rounding.

    Returns:
        The disc of the pixels that get samples, and how many each gets, at least 1.
    """
    if disc.covers_frame or not disc.count:
        return disc, spp
    plain = disc.arrays.plain
    start = int(np.random.SeedSequence(seed).generate_state(1)[0])
    start, most = disc.arrays.scalars(plain.UInt, [start, spp])
    width = disc.arrays.constant(disc.width)
    row = disc.pixels // width
    column = disc.pixels - row * width
    # The sum wraps around on purpose: only its fractional part counts.
    mask = plain.Float64(column * _ACROSS + row * _DOWN + start) * 2.0**-32
    due = dr.floor(plain.Float64(most) * plain.Float64(disc.weights) + mask)
    count = dr.select(disc.weights < 1, plain.UInt(due), most)
    has_samples = count > 0
    # At once, before the pixels that are kept look it up.
    dr.eval(count, has_samples)
    kept = dr.compress(has_samples)
    if not dr.width(kept):
        nothing = dr.zeros(plain.UInt, 0), dr.zeros(plain.Float, 0)
        return replace(disc, pixels=nothing[0], weights=nothing[1], box=None), spp
    pixels, count = (dr.gather(plain.UInt, of, kept) for of in (disc.pixels, count))
    weights = dr.maximum(dr.gather(plain.Float, disc.weights, kept), 1 / plain.Float(most))
    # In one kernel with what needs them first.
    dr.schedule(pixels, count, weights)
    thin = replace(disc, pixels=pixels, weights=weights)
    return thin, 1 if spp == 1 else Counts.of(count, spp)
