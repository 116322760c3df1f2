"""Irradiance caches of scenes, kept in files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from compose.base.checksum import checksum
from compose.base.files import write_whole
from pathtrace.cache.cache import IrradianceCache
from pathtrace.cache.cells import SIDES, Cells, Grid, Points
from pathtrace.cache.lights import LightChoice
from pathtrace.cache.patches import Patches
from pathtrace.cache.transfer import Rays, Transfer
from pathtrace.cache.transport import Transport

_CHECKSUM = "crc32"


def stored_cache(path: Path, fill: Callable[[], IrradianceCache]) -> IrradianceCache:
    """The cache in a file; if there is none or it is damaged, one that is filled and stored now.

    Args:
        path: the file.
        fill: fills a cache.

    Raises:
        UserError: the file cannot be written.
    """
    try:
        return _cache(_stored(path))
    except (OSError, SafetensorError, LookupError, ValueError, TypeError, OverflowError):
        cache = fill()
        arrays = _arrays(cache)
        # The library's own file writing leaves a file of another name behind if the process dies meanwhile.
        content = save(arrays, {_CHECKSUM: checksum(arrays)})
        write_whole(path, lambda part: part.write_bytes(content))
        return cache


def _stored(path: Path) -> dict[str, NDArray[np.generic]]:
    """The arrays in a file.

    Raises:
        OSError, SafetensorError, ValueError: it cannot be read, or is damaged.
    """
    with safe_open(path, framework="np") as file:
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        expected = (file.metadata() or {}).get(_CHECKSUM)
    if expected not in (None, checksum(arrays)):
        raise ValueError("the checksum differs")
    return arrays


def _arrays(cache: IrradianceCache) -> dict[str, NDArray[np.generic]]:
    """A cache as arrays by name."""
    cells, lights = cache.cells, cache.lights
    transfer, transport = cache.transfer, cache.transfer.transport
    arrays: dict[str, NDArray[np.generic]] = {
        "origin": cells.grid.origin,
        "scale": np.array([cells.grid.scale]),
        "irradiance": cache.irradiance,
        "lights.keys": lights.keys,
        "lights.chances": lights.chances,
        "points.position": transfer.points.position,
        "points.normal": transfer.points.normal,
        "points.patch": transfer.patch,
        "rays.point": transfer.rays.point,
        "rays.square": transfer.rays.square,
        "rays.weight": transfer.rays.weight,
        "direct": transfer.direct,
        "reflected": transfer.reflected,
        "passed": transfer.passed,
        "known": transfer.known,
        "patches.cells": transport.patches.cells,
        "patches.rays": transport.rays,
        "links.starts": transport.starts,
        "links.cells": transport.cells,
        "links.reflectance": transport.reflectance,
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
    irradiance, transfer = arrays["irradiance"].astype(np.float32), _transfer(arrays)
    if irradiance.shape[1:] != (len(cells), 3) or not np.isfinite(irradiance).all():
        raise ValueError("irradiance does not match the cells")
    if transfer.known.sum() != len(cells):
        raise ValueError("transfer does not match the cells")
    names, chances = arrays["lights.keys"].astype(np.uint64), arrays["lights.chances"].astype(np.float32)
    return IrradianceCache(cells, irradiance, LightChoice(grid, names, chances), transfer)


def _transfer(arrays: dict[str, NDArray[np.generic]]) -> Transfer:
    """The transfer of `_arrays`.

    Raises:
        KeyError, ValueError: something is missing, or sizes do not match.
    """
    single = lambda name: arrays[name].astype(np.float32)  # noqa: E731
    whole = lambda name: arrays[name].astype(np.int32)  # noqa: E731
    known = arrays["known"].astype(bool)
    patches = Patches(whole("patches.cells"), len(known))
    links = whole("links.cells"), single("links.reflectance")
    transport = Transport(patches, whole("patches.rays"), whole("links.starts"), *links)
    points, rays = Points(single("points.position"), single("points.normal")), whole("rays.point")
    transfer = Transfer(
        points,
        whole("points.patch"),
        Rays(rays, single("rays.square"), single("rays.weight")),
        single("direct"),
        single("reflected"),
        single("passed"),
        transport,
        known,
    )
    transfer.check()
    return transfer
