"""What must be there before the first frame: the scene, its forest, and kernels that are compiled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from compose.base.errors import UserError
from compose.eye.display import Display
from hybrid.cli.options import loaded_scene, select
from hybrid.frame.live import LiveRenderer
from hybrid.frame.periphery import Viewing
from hybrid.interactive.source import FrameSource
from hybrid.runtime.progress import Bar, Report
from hybrid.store.cache import newest_forest
from hybrid.training.quick import forest_for


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
