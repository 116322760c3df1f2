"""Irradiance caches of scenes, kept in files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from compose.base.files import write_whole
from pathtrace.cache.cache import IrradianceCache
from pathtrace.cache.cells import SIDES, Cells, Grid
from pathtrace.cache.lights import LightChoice


def stored_cache(path: Path, fill: Callable[[], IrradianceCache]) -> IrradianceCache:
    """The cache in a file; if there is none or it is damaged, one that is filled and stored now.

    Args:
        path: the file.
        fill: fills a cache.

    Raises:
        UserError: the file cannot be written.
    """
    try:
        return _cache(load_file(path))
    except (OSError, SafetensorError, KeyError, ValueError):
        cache = fill()
        write_whole(path, lambda part: save_file(_arrays(cache), part))
        return cache


def _arrays(cache: IrradianceCache) -> dict[str, NDArray[np.generic]]:
    """A cache as arrays by name."""
    cells, lights = cache.cells, cache.lights
    arrays: dict[str, NDArray[np.generic]] = {
        "origin": cells.grid.origin,
        "scale": np.array([cells.grid.scale]),
        "irradiance": cache.irradiance,
        "lights.keys": lights.keys,
        "lights.chances": lights.chances,
    }
    for level, (keys, counts) in enumerate(zip(cells.keys, cells.counts, strict=True)):
        arrays |= {f"keys.{level}": keys, f"counts.{level}": counts}
    return {name: np.ascontiguousarray(values) for name, values in arrays.items()}


def _cache(arrays: dict[str, NDArray[np.generic]]) -> IrradianceCache:
    """The cache of `_arrays`.

    Raises:
        KeyError, ValueError: something is missing, or sizes do not match.
    """
    grid = Grid(arrays["origin"].astype(np.float32), float(arrays["scale"][0]))
    levels = range(len(SIDES))
    keys = tuple(arrays[f"keys.{level}"].astype(np.uint64) for level in levels)
    cells = Cells(grid, keys, tuple(arrays[f"counts.{level}"].astype(np.int64) for level in levels))
    irradiance = arrays["irradiance"].astype(np.float32)
    if irradiance.shape[1:] != (len(cells), 3) or not np.isfinite(irradiance).all():
        raise ValueError("irradiance does not match the cells")
    names, chances = arrays["lights.keys"].astype(np.uint64), arrays["lights.chances"].astype(np.float32)
    return IrradianceCache(cells, irradiance, LightChoice(grid, names, chances))
