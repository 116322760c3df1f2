"""The rasterizer alone, on Gaussians drawn at random in the frame."""

from __future__ import annotations

import time
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from hybrid.base.compute_device import device_arrays
from hybrid.base.progress import Steps
from hybrid.measure.frame_times import percentiles
from splat.raster.binning import Candidates
from splat.raster.blending import gradients_from_sums
from splat.raster.blocks import CHANNELS
from splat.raster.parts import Parts, rasterize_parts, sums_of_parts
from splat.raster.projection import Splats
from splat.raster.tiles import TileGrid


def bench_raster(
    gaussians: int, size: tuple[int, int], seed: int, repeats: int, warm_up: int, progress: Steps
) -> dict[str, Any]:
    """Times of binning and blending (forward) and of the gradient (backward), with all data on the device.

    The same seed gives the same splats. Returns the arguments, percentiles forward_ms and backward_ms, and
    pairs of splats and tiles.
    """
    arrays, (width, height), rng = device_arrays(), size, np.random.default_rng(seed)
    splats = random_splats(arrays, gaussians, width, height, rng)
    grid = TileGrid(width, height)
    # Of the loss by the padded image.
    values = rng.normal(size=grid.padded_width * grid.padded_height * CHANNELS)
    gradient = arrays.plain.Float(values.astype(np.float32))
    dr.eval(gradient)
    forward, backward = [], []
    for step in range(-warm_up, repeats):
        start = time.perf_counter()
        parts = Parts(Candidates.of(arrays, splats, grid))
        (image,) = rasterize_parts(arrays, parts)
        dr.sync_thread()
        middle = time.perf_counter()
        dr.eval(gradients_from_sums(splats, sums_of_parts(arrays, parts, image, gradient)))
        dr.sync_thread()
        if step >= 0:
            forward.append((middle - start) * 1000)
            backward.append((time.perf_counter() - middle) * 1000)
        progress(step + warm_up + 1, warm_up + repeats)
    return {
        "gaussians": gaussians,
        "width": width,
        "height": height,
        "pairs": sum(bins.pairs for bins in parts),
        "forward_ms": percentiles(forward),
        "backward_ms": percentiles(backward),
        "repeats": repeats,
    }


def random_splats(arrays: Arrays, count: int, width: int, height: int, rng: np.random.Generator) -> Splats:
    """Splats in random positions, of random sizes and colours.

    Means are uniform over the frame, standard deviations 0.5 px + lognormal(0.7, 0.6), opacities uniform in
    0.05..0.99, depths uniform in 1..10.
    """
    x, y = rng.uniform(0, width, count), rng.uniform(0, height, count)
    sd = 0.5 + rng.lognormal(0.7, 0.6, (2, count))
    turn = rng.uniform(0, np.pi, count)  # of the longer axis
    opacity, colour = rng.uniform(0.05, 0.99, count), rng.uniform(0, 1, (3, count))
    depth = rng.uniform(1, 10, count)
    cosine, sine, (a, b) = np.cos(turn), np.sin(turn), 1 / sd**2
    # Entries of the inverse covariance, whose determinant is a b.
    xx, xy = cosine**2 * a + sine**2 * b, cosine * sine * (a - b)
    values = (x, y, xx, xy / xx, a * b / xx, opacity, *colour, depth)
    splats = Splats(*(arrays.plain.Float(v.astype(np.float32)) for v in values))
    dr.eval(splats.__dict__)
    return splats
