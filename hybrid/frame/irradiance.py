"""The irradiance cache of a scene, and the tracer whose paths end in it."""

from __future__ import annotations

from collections.abc import Callable

from compose.base.errors import UserError
from hybrid.runtime.progress import Bars, no_bars, no_progress
from hybrid.store.cache import scene_folder
from hybrid.store.irradiance import stored_cache
from pathtrace.cache.cache import IrradianceCache
from pathtrace.dataset.views import choose_views
from pathtrace.fill.fill import fill_cache
from pathtrace.fill.relight import Relighting
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces
from pathtrace.trace.tracer import Tracer

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


def filled_cache(
    scene: Scene, progress: Callable[[int, int], None] = no_progress, seed: int = 0
) -> IrradianceCache:
    """A cache filled for views around the scene's own camera; of a scene that moves, at time 0.

    Args:
        scene: the scene.
        progress: called with steps done and steps in total.
        seed: same seed, same cache on the same machine.
    """
    scene.show(0.0)
    camera = scene.camera
    try:
        views = choose_views(scene, Surfaces(scene), _VIEWS, camera.width, camera.height, 0)
        cameras = [*views.fixed, *views.spread]
    except UserError:
        # There is no free space around the camera.
        cameras = [camera]
    return fill_cache(scene, cameras, seed, progress)


class CachedTracer:
    """Traces a scene by paths that end in a cache, whose light follows the lights of the scene.

    Args:
        scene: the scene.
        cache: of it.
        roulette_depth: path depth from which Russian roulette ends paths; that of the scene if None.

    Attributes:
        tracer: traces, with what is known of the light now.
    """

    def __init__(self, scene: Scene, cache: IrradianceCache, roulette_depth: int | None):
        self.tracer = Tracer(scene, roulette_depth=roulette_depth, cache=cache)
        self._scene, self._cache = scene, cache
        self._relighting: Relighting | None = None

    @property
    def renewed(self) -> float:
        """Share, 0 to 1, of the work that was done to follow the last change of lights; 1 if none changed."""
        return self._cache.renewed if self._relighting is None else self._relighting.renewed

    def lights_changed(self) -> None:
        """Says that the scene's lights changed; the light known now is old."""
        if self._relighting is not None:
            self._relighting.change()
        # Without cells, nothing is known, and all paths are traced to their ends.
        elif len(self._cache.cells):
            self._relighting = Relighting(self._scene, self._cache)

    def update(self) -> None:
        """Renews a part of the light; to be called before each frame, it takes no time when all is known."""
        if self._relighting is not None and self._relighting.renewed < 1:
            self.tracer.relight(self._relighting.update())
