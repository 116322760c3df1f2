"""What must be there before the first frame: the scene, its forest, and kernels that are compiled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from compose.errors import UserError
from compose.view import Display
from hybrid.cache import forest_for, newest_forest
from hybrid.demo.source import FrameSource
from hybrid.live import LiveRenderer
from hybrid.options import loaded_scene, select
from hybrid.periphery import Viewing
from hybrid.progress import Bar, Report


def prepared(
    scene: str,
    forest: Path | None,
    display: Display,
    backend: str,
    trains: bool,
    report: Report,
) -> FrameSource:
    """The source of frames of a scene.

    Args:
        scene, forest, backend: as the options of that name.
        display: that the window is shown on.
        trains: whether a forest that is missing is trained now.
        report: called with what is done, how many steps of it, and of how many.

    Raises:
        UserError: there is no such scene or forest, or they do not belong together.
    """

    @contextmanager
    def bars(title: str) -> Iterator[Bar]:
        yield lambda done, total, step="": report(title, done, total)

    select(backend)
    loaded = loaded_scene(scene)
    if not trains and forest is None and newest_forest(loaded) is None:
        raise UserError(f"{scene}: there is no forest yet, and no time to train one; run hybrid demo {scene}")
    found = forest_for(loaded, forest, bars)
    return FrameSource(LiveRenderer(loaded, found, Viewing(display)))
