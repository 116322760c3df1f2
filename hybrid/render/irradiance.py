"""The irradiance cache of a scene: filled once, kept in a file, and the tracer whose paths end in it."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from compose.base.errors import UserError
from compose.base.files import checksum, write_whole
from hybrid.base.cache_folder import scene_folder
from hybrid.base.progress import Bars, Steps, no_bars, no_progress
from pathtrace.cache.cells import SIDES, Cells, Grid, Points
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.cache.light_selection import LightChoice
from pathtrace.cache.transport import Patches, Rays, Transfer, Transport
from pathtrace.fill.filling import at_depth_of, fill_cache
from pathtrace.fill.relight import Relighting
from pathtrace.region.neighbourhood import choose_views
from pathtrace.scene.scene import Scene
from pathtrace.trace.tracer import Tracer

_CHECKSUM = "crc32"


def stored_cache(path: Path, fill: Callable[[], IrradianceCache]) -> IrradianceCache:
    """The cache in a file; if there is none or it is damaged, one that is filled and stored now."""
    try:
        with safe_open(path, framework="np") as file:
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            expected = (file.metadata() or {}).get(_CHECKSUM)
        if expected not in (None, checksum(arrays)):
            raise ValueError("the checksum differs")
        return _cache(arrays)
    except (OSError, SafetensorError, LookupError, ValueError, TypeError, OverflowError):
        cache = fill()
        arrays = _arrays(cache)
        # The library's own file writing leaves a file of another name behind if the process dies meanwhile.
        content = save(arrays, {_CHECKSUM: checksum(arrays)})
        write_whole(path, lambda part: part.write_bytes(content))
        return cache


# The arrays in a file by their places in a cache, and the types that they are read as.
_FIELDS: dict[str, tuple[str, type]] = {
    "origin": ("cells.grid.origin", np.float32),
    "irradiance": ("irradiance", np.float32),
    "lights.keys": ("lights.keys", np.uint64),
    "lights.chances": ("lights.chances", np.float32),
    "points.position": ("transfer.points.position", np.float32),
    "points.normal": ("transfer.points.normal", np.float32),
    "points.patch": ("transfer.patch", np.int32),
    "rays.point": ("transfer.rays.point", np.int32),
    "rays.square": ("transfer.rays.square", np.float32),
    "rays.weight": ("transfer.rays.weight", np.float32),
    "direct": ("transfer.direct", np.float32),
    "reflected": ("transfer.reflected", np.float32),
    "passed": ("transfer.passed", np.float32),
    "known": ("transfer.known", bool),
    "patches.cells": ("transfer.transport.patches.cells", np.int32),
    "patches.rays": ("transfer.transport.rays", np.int32),
    "links.starts": ("transfer.transport.starts", np.int32),
    "links.cells": ("transfer.transport.cells", np.int32),
    "links.reflectance": ("transfer.transport.reflectance", np.float32),
}


def _arrays(cache: IrradianceCache) -> dict[str, NDArray[np.generic]]:
    cells = cache.cells
    arrays = {name: attrgetter(place)(cache) for name, (place, _) in _FIELDS.items()}
    arrays["scale"] = np.array([cells.grid.scale])
    for level, (keys, counts) in enumerate(zip(cells.keys, cells.counts, strict=True)):
        arrays |= {f"keys.{level}": keys, f"counts.{level}": counts}
    return {name: np.ascontiguousarray(values) for name, values in arrays.items()}


def _cache(arrays: dict[str, NDArray[np.generic]]) -> IrradianceCache:
    """The cache of `_arrays`; KeyError or ValueError if something is missing, or sizes do not match."""
    of: dict[str, Any] = {name: arrays[name].astype(kind) for name, (_, kind) in _FIELDS.items()}
    grid, levels = Grid(of["origin"], float(arrays["scale"][0])), range(len(SIDES))
    keys = tuple(arrays[f"keys.{level}"].astype(np.uint64) for level in levels)
    cells = Cells(grid, keys, tuple(arrays[f"counts.{level}"].astype(np.int64) for level in levels))
    known, irradiance = of["known"], of["irradiance"]
    links = of["links.starts"], of["links.cells"], of["links.reflectance"]
    transfer = Transfer(
        Points(of["points.position"], of["points.normal"]),
        of["points.patch"],
        Rays(of["rays.point"], of["rays.square"], of["rays.weight"]),
        *(of["direct"], of["reflected"], of["passed"]),
        Transport(Patches(of["patches.cells"], len(known)), of["patches.rays"], *links),
        known,
    )
    transfer.check()
    if irradiance.shape[1:] != (len(cells), 3) or not np.isfinite(irradiance).all():
        raise ValueError("irradiance does not match the cells")
    if known.sum() != len(cells):
        raise ValueError("transfer does not match the cells")
    lights = LightChoice(grid, of["lights.keys"], of["lights.chances"])
    return IrradianceCache(cells, irradiance, lights, transfer)


# Views around the scene's own camera whose paths a cache is filled for.
_VIEWS = 8


def cache_for(scene: Scene, bars: Bars = no_bars) -> IrradianceCache:
    """The stored cache of a scene; if there is none, it is filled in seconds and stored.

    One file serves all path depths: what is stored is how light passes from cell to cell.
    """
    own = scene.at_depth(scene.own_depth)
    file = scene_folder(own.name, own.hash) / "irradiance.safetensors"

    def filled() -> IrradianceCache:
        with bars("irradiance (steps)") as bar:
            return filled_cache(own, bar)

    cache = stored_cache(file, filled)
    return cache if scene.hash == own.hash else at_depth_of(scene, cache)


def filled_cache(scene: Scene, progress: Steps = no_progress) -> IrradianceCache:
    """A cache filled for views around the scene's own camera; of a scene that moves, at time 0."""
    scene.show(0.0)
    camera = scene.camera
    try:
        views = choose_views(scene, scene.surfaces(), _VIEWS, camera.width, camera.height, 0)
        cameras = [*views.fixed, *views.spread]
    except UserError:
        # There is no free space around the camera.
        cameras = [camera]
    return fill_cache(scene, cameras, 0, progress)


class CachedTracer:
    """Traces a scene by paths that end in its cache, whose light follows the lights of the scene.

    Russian roulette ends paths from a path depth on, by default that of the scene. `tracer` traces with
    `cache`, what is known of the light now.
    """

    def __init__(self, scene: Scene, cache: IrradianceCache, roulette_depth: int | None):
        self.tracer = Tracer(scene, roulette_depth=roulette_depth, cache=cache)
        self._scene, self.cache = scene, cache
        self._relighting: Relighting | None = None

    @property
    def renewed(self) -> float:
        """Share, 0 to 1, of the work that was done to follow the last change of lights; 1 if none changed."""
        return self.cache.renewed if self._relighting is None else self._relighting.renewed

    def lights_changed(self) -> None:
        """Says that the scene's lights changed; the light known now is old."""
        if self._relighting is not None:
            self._relighting.change()
        # Without cells, nothing is known, and all paths are traced to their ends.
        elif len(self.cache.cells):
            self._relighting = Relighting(self._scene, self.cache)

    def update(self) -> None:
        """Renews a part of the light; to be called before each frame, it takes no time when all is known."""
        if self._relighting is not None and self._relighting.renewed < 1:
            self.cache = self._relighting.update()
            self.tracer.relight(self.cache)
