"""The irradiance cache of a scene."""

from __future__ import annotations

from compose.base.errors import UserError
from hybrid.store.cache import scene_folder
from hybrid.store.irradiance import stored_cache
from pathtrace.cache.cache import IrradianceCache
from pathtrace.dataset.views import choose_views
from pathtrace.fill.fill import fill_cache
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces

# Views around the scene's own camera whose paths a cache is filled for.
_VIEWS = 8


def cache_for(scene: Scene) -> IrradianceCache:
    """The stored cache of a scene; if there is none, it is filled in seconds and stored.

    Raises:
        UserError: the cache folder cannot be written.
    """
    file = scene_folder(scene.name, scene.hash) / "irradiance.safetensors"
    return stored_cache(file, lambda: filled_cache(scene))


def filled_cache(scene: Scene) -> IrradianceCache:
    """A cache filled for views around the scene's own camera."""
    camera = scene.camera
    try:
        views = choose_views(scene, Surfaces(scene), _VIEWS, camera.width, camera.height, 0)
        cameras = [*views.fixed, *views.spread]
    except UserError:
        # There is no free space around the camera.
        cameras = [camera]
    return fill_cache(scene, cameras)
