"""The way of a frame's settings through the code: short, as drawn, and never up."""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import groupby, pairwise
from pathlib import Path
from types import FrameType

import pytest

from hybrid.render.frame_settings import FrameSettings
from tests.test_imports import ROOT, rows_below

pytestmark = pytest.mark.usefixtures("backend")
MOST_CLIMBS, MOST_RETURNS = 4, 8
FLOORS = ("compose", "splat", "pathtrace", "hybrid")


def way_of_settings(call: Callable[[], object]) -> list[str]:
    """The files that settings are handed to while something is called, and back, in order."""
    stops: list[str] = []
    holders: list[tuple[FrameType, str]] = []

    def watch(frame: FrameType, event: str, _: object) -> None:
        if event == "return" and holders and holders[-1][0] is frame:
            holders.pop()
            stops.extend(path for _, path in holders[-1:])
        code, path = frame.f_code, Path(frame.f_code.co_filename)
        # What settings do themselves is no stop.
        caller = "" if frame.f_back is None else frame.f_back.f_code.co_filename
        own = any(name.endswith("frame_settings.py") for name in (path.name, caller))
        if event != "call" or own or not path.is_relative_to(ROOT):
            return
        arguments = (frame.f_locals.get(name) for name in code.co_varnames[: code.co_argcount])
        if any(isinstance(one, FrameSettings) for one in arguments):
            holders.append((frame, str(path.relative_to(ROOT))))
            stops.append(holders[-1][1])

    sys.setprofile(watch)
    try:
        call()
    finally:
        sys.setprofile(None)
    return [path for path, _ in groupby(stops)]


def test_settings_take_a_short_way(renderer):
    settings = FrameSettings(spp=1, camera=renderer.scene.camera.resized(64, 48))
    renderer.frame(settings)
    way = way_of_settings(lambda: renderer.frame(settings, seed=1))
    floors = [FLOORS.index(path.split("/")[0]) for path in way]
    returns = sum(path in way[:number] for number, path in enumerate(way))
    assert sum(after > before for before, after in pairwise(floors)) <= MOST_CLIMBS
    assert returns <= MOST_RETURNS
    drawn = [file.strip("`") for file, _ in rows_below("The way of settings")]
    assert way == drawn
