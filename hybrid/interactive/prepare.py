"""Prepares what the first frame needs: scene, forest and renderer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from compose.base.errors import UserError
from hybrid.frame.irradiance import cache_for
from hybrid.frame.live import LiveRenderer
from hybrid.frame.settings import FrameSettings
from hybrid.interactive.source import FrameSource
from hybrid.plan.stored import planned_scene
from hybrid.preparation.quick import forest_for
from hybrid.runtime.progress import Bar, Report
from hybrid.store.cache import newest_forest
from pathtrace.base.backend import select_backend
from pathtrace.trace.integrator import Integrator


def prepared(
    scene: str,
    forest: Path | None,
    backend: str,
    trains: bool,
    settings: FrameSettings,
    report: Report,
    thin_glass: bool = False,
) -> FrameSource:
    """The source of a scene's frames.

    Args:
        scene: name of a bundled scene, or a Mitsuba XML file.
        forest: forest file; None for the newest one of the scene.
        backend: auto, cuda or llvm.
        trains: whether to train a forest if there is none.
        settings: of the first frame.
        report: called with the activity, steps done and steps in total.
        thin_glass: whether panes of glass let shadow rays pass.

    Raises:
        UserError: the scene or the forest is missing, or they do not belong together.
    """

    @contextmanager
    def bars(title: str) -> Iterator[Bar]:
        yield lambda done, total, step="": report(title, done, total)

    # Before the scene is loaded, since the backend decides what it is loaded into.
    select_backend(backend)
    loaded = planned_scene(scene, thin_glass=thin_glass, bars=bars)
    if not trains and forest is None and newest_forest(loaded) is None:
        raise UserError(f"{scene}: there is no forest yet; run hybrid demo {scene} first, which trains one")
    found = forest_for(loaded, forest, bars)
    if settings.used_integrator is Integrator.CACHED:
        cache_for(loaded, bars)
    return FrameSource(LiveRenderer(loaded, found))
