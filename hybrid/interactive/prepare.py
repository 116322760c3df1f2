"""Prepares what must be there before the first frame: scene, forest and renderer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from compose.base.errors import UserError
from hybrid.frame.live import LiveRenderer
from hybrid.interactive.source import FrameSource
from hybrid.runtime.progress import Bar, Report
from hybrid.store.cache import newest_forest
from hybrid.training.quick import forest_for
from pathtrace.base.backend import select_backend


def prepared(scene: str, forest: Path | None, backend: str, trains: bool, report: Report) -> FrameSource:
    """The source of a scene's frames.

    Args:
        scene: name of a bundled scene, or a Mitsuba XML file.
        forest: forest file; None for the newest one of the scene.
        backend: auto, cuda or llvm.
        trains: whether to train a forest if there is none.
        report: called with the activity, steps done and steps in total.

    Raises:
        UserError: the scene or the forest is missing, or they do not belong together.
    """

    @contextmanager
    def bars(title: str) -> Iterator[Bar]:
        yield lambda done, total, step="": report(title, done, total)

    select_backend(backend)
    # After the backend, which decides on the kind of scene that is loaded.
    from pathtrace.scene.scene import load_scene

    loaded = load_scene(scene)
    if not trains and forest is None and newest_forest(loaded) is None:
        raise UserError(f"{scene}: there is no forest yet, and no time to train one; run hybrid demo {scene}")
    return FrameSource(LiveRenderer(loaded, forest_for(loaded, forest, bars)))
