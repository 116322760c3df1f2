"""The irradiance cache of a scene."""

from __future__ import annotations

from collections.abc import Callable

from compose.base.errors import UserError
from hybrid.runtime.progress import Bars, no_bars, no_progress
from hybrid.store.cache import scene_folder
from hybrid.store.irradiance import stored_cache
from pathtrace.cache.cache import IrradianceCache
from pathtrace.dataset.views import choose_views
from pathtrace.fill.fill import fill_cache
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces

# Views around the scene's own camera whose paths a cache is filled for.
_VIEWS = 8


def cache_for(scene: Scene, bars: Bars = no_bars) -> IrradianceCache:
    """The stored cache of a scene; if there is none, it is filled in seconds and stored.

    Args:
        scene: the scene.
        bars: show the progress of filling it.

    Raises:
        UserError: the cache folder cannot be written.
    """
    file = scene_folder(scene.name, scene.hash) / "irradiance.safetensors"

    def filled() -> IrradianceCache:
        with bars("irradiance (steps)") as bar:
            return filled_cache(scene, bar)

    return stored_cache(file, filled)


def filled_cache(scene: Scene, progress: Callable[[int, int], None] = no_progress) -> IrradianceCache:
    """A cache filled for views around the scene's own camera.

    Args:
        scene: the scene.
        progress: called with steps done and steps in total.
    """
    camera = scene.camera
    try:
        views = choose_views(scene, Surfaces(scene), _VIEWS, camera.width, camera.height, 0)
        cameras = [*views.fixed, *views.spread]
    except UserError:
        # There is no free space around the camera.
        cameras = [camera]
    return fill_cache(scene, cameras, progress=progress)
