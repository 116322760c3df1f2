"""The irradiance cache that a forest carries, or that is filled for a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from compose.base.errors import UserError
from pathtrace.cache.cache import IrradianceCache
from pathtrace.cache.cells import SIDES, Cells, Grid
from pathtrace.cache.lights import LightChoice
from pathtrace.dataset.views import choose_views
from pathtrace.fill.fill import fill_cache
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces
from splat.model.forest import Forest

_PREFIX = "irradiance."
# Views around the scene's own camera whose paths a cache is filled for.
_VIEWS = 8


def attach_cache(forest: Forest, cache: IrradianceCache) -> Forest:
    """The forest with a cache attached, which its file then contains."""
    grid, cells, lights = cache.cells.grid, cache.cells, cache.lights
    arrays = {
        "origin": grid.origin,
        "scale": np.array(grid.scale),
        "values": cache.irradiance,
        "lights.keys": lights.keys.view(np.int64),
        "lights.chances": lights.chances,
    }
    for level, (keys, counts) in enumerate(zip(cells.keys, cells.counts, strict=True)):
        arrays |= {f"keys.{level}": keys.view(np.int64), f"counts.{level}": counts}
    state = {_PREFIX + name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in arrays.items()}
    return replace(forest, attached={**forest.attached, **state})


def cache_of(forest: Forest) -> IrradianceCache | None:
    """The cache that is attached to a forest; None if there is none.

    Raises:
        UserError: the cache is damaged.
    """
    state = {
        name.removeprefix(_PREFIX): tensor.numpy()
        for name, tensor in forest.attached.items()
        if name.startswith(_PREFIX)
    }
    if not state:
        return None
    try:
        grid = Grid(state["origin"], state["scale"].item())
        keys = tuple(state[f"keys.{level}"].view(np.uint64) for level in range(len(SIDES)))
        counts = tuple(state[f"counts.{level}"] for level in range(len(SIDES)))
        lights = LightChoice(grid, state["lights.keys"].view(np.uint64), state["lights.chances"])
        cache = IrradianceCache(Cells(grid, keys, counts), state["values"], lights)
    except (KeyError, ValueError) as error:
        raise UserError("the forest's irradiance cache is damaged; train the forest again") from error
    if cache.irradiance.shape[1:] != (len(cache.cells), 3) or not np.isfinite(cache.irradiance).all():
        raise UserError("the forest's irradiance cache is damaged; train the forest again")
    return cache


def cache_for(scene: Scene) -> IrradianceCache:
    """A cache filled for views around the scene's own camera, in seconds."""
    camera = scene.camera
    try:
        views = choose_views(scene, Surfaces(scene), _VIEWS, camera.width, camera.height, 0)
        cameras = [*views.fixed, *views.spread]
    except UserError:
        # There is no free space around the camera.
        cameras = [camera]
    return fill_cache(scene, cameras)
