"""Splats made by hand, and a float64 twin that blends them pixel by pixel."""

from __future__ import annotations

import drjit as dr
import numpy as np
import torch

from splat.raster.binning import Bins, Candidates, TileBounds, boxed, depth_order
from splat.raster.blending import ImageSplit, gradients_from_sums, rasterize, sums_of_bins
from splat.raster.differentiable import aligned_rows, parameters_of
from splat.raster.projection import Parameters, Splats
from splat.raster.tiles import TileGrid
from tests.splat.raster import reference

NAMES = ("x", "y", "x_precision", "shear", "y_precision", "opacity", "red", "green", "blue", "depth")


def parameters_from(arrays, gaussians) -> Parameters:
    """The Gaussians' rows as kernels read them."""
    return parameters_of(aligned_rows(arrays, [tensor for _, tensor in gaussians.tensors()]))


def round_splats(arrays, rows: list[tuple[float, ...]]) -> Splats:
    """Round splats from rows of x, y, standard deviation in px, opacity, red, green, blue, depth."""
    x, y, deviation, opacity, red, green, blue, depth = np.array(rows, dtype=np.float64).T
    inverse = 1 / deviation**2
    return of_inverse(arrays, [x, y, inverse, 0 * x, inverse, opacity, red, green, blue, depth])


def random_splats(arrays, count: int, width: int, height: int, seed: int = 0) -> Splats:
    """Ellipses in and around a frame, from a third of a pixel to some 12 pixels, long ones among them."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-8, width + 8, count), rng.uniform(-8, height + 8, count)
    a, b = 1 / np.exp(rng.uniform(-1, 2.5, (2, count))) ** 2
    turn = rng.uniform(0, np.pi, count)
    cosine, sine = np.cos(turn), np.sin(turn)
    xx, yy = cosine**2 * a + sine**2 * b, sine**2 * a + cosine**2 * b
    # Invisible and opaque ones among them.
    opacity = rng.uniform(-0.1, 1.1, count).clip(0, 1)
    colour = rng.uniform(0, 2, (3, count))
    return of_inverse(
        arrays, [x, y, xx, cosine * sine * (a - b), yy, opacity, *colour, rng.uniform(1, 9, count)]
    )


def of_inverse(arrays, rows: list[np.ndarray]) -> Splats:
    """Splats from rows in the order of NAMES, but with the entries xx, xy, yy of the inverse covariance."""
    x, y, xx, xy, yy, *rest = (np.asarray(row, dtype=np.float64) for row in rows)
    return uploaded(arrays, [x, y, xx, xy / xx, yy - xy**2 / xx, *rest])


def uploaded(arrays, rows: list[np.ndarray]) -> Splats:
    """Splats from rows in the order of NAMES."""
    splats = Splats(*(arrays.plain.Float(np.asarray(row, dtype=np.float32)) for row in rows))
    dr.eval(splats.__dict__)
    return splats


def inverse_covariance(splats: Splats) -> dict[str, np.ndarray]:
    """Entries xx, xy, yy of the inverse of the 2D covariance, in 1/px^2, in float32."""
    xy = splats.x_precision * splats.shear
    entries = {"xx": splats.x_precision, "xy": xy, "yy": dr.fma(xy, splats.shear, splats.y_precision)}
    return {name: dr.detach(entry, preserve_type=False).numpy() for name, entry in entries.items()}


def doubles(splats: Splats) -> dict[str, np.ndarray]:
    """The splats' numbers in float64, by name."""
    return {name: getattr(splats, name).numpy().astype(np.float64) for name in NAMES}


def exponent(s: dict[str, np.ndarray], dx: np.ndarray, dy: np.ndarray) -> np.ndarray:
    """q of alpha = opacity exp(-q / 2) at offsets from the centres of splats, as `doubles` returns them."""
    return s["x_precision"] * (dx + s["shear"] * dy) ** 2 + s["y_precision"] * dy**2


def blended(leaves: dict[str, torch.Tensor], width: int, height: int) -> torch.Tensor:
    """(H, W, 3) the twin's image of float64 tensors by name."""
    a, shear, b = leaves["x_precision"], leaves["shear"], leaves["y_precision"]
    rows = [[a, a * shear], [a * shear, a * shear**2 + b]]
    inverse = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
    splats = {
        "centre": torch.stack([leaves["x"], leaves["y"]]),
        "inverse": inverse,
        "opacity": leaves["opacity"],
        "colour": torch.stack([leaves["red"], leaves["green"], leaves["blue"]]),
        "depth": leaves["depth"],
    }
    return reference.blend(splats, width, height)


def candidates_of(arrays, splats: Splats, grid, wanted=None, bounds=None, in_order=False) -> Candidates:
    """Candidates of splats, each confined to some tiles, and in order from near to far or not."""
    UInt = arrays.plain.UInt
    bounds = bounds or TileBounds(UInt(grid.columns), UInt(0), UInt(grid.rows))
    found = boxed(arrays, splats, bounds, grid.side)
    return Candidates(
        arrays, found, grid, wanted, None if in_order else depth_order(arrays, splats.depth, found.count > 0)
    )


def bin_splats(*given, **settings) -> Bins:
    """The lists of all tiles at once, from what `candidates_of` takes."""
    candidates = candidates_of(*given, **settings)
    return candidates.bins(candidates.runs(candidates.whole))


def rasterized(arrays, splats: Splats, bins: Bins, heights: list[int] | None = None) -> list:
    """Images of so many rows of tiles, or one of all, from the lists of all tiles at once."""
    split = ImageSplit.of(arrays, bins.grid, heights or [bins.grid.rows])
    return rasterize(arrays, blended_records(arrays, splats), bins, split)


def blended_records(arrays, splats: Splats):
    """What tiles read of splats."""
    return candidates_of(arrays, splats, TileGrid(1, 1)).found.blended


def rasterize_backward(arrays, splats: Splats, bins: Bins, image, gradient) -> list:
    """Gradients by the splats from the lists of all tiles at once."""
    sums = sums_of_bins(arrays, blended_records(arrays, splats), bins, image, gradient)
    return gradients_from_sums(splats, sums)
