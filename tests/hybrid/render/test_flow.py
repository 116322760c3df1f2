"""Data flows down: no call inside a frame leads from a package to one that stands on it."""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType

from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import load_scene
from tests import small
from tests.hybrid.forests import rough_forest

ROOT = Path(__file__).resolve().parents[3]
FLOORS = {"compose": 1, "pathtrace": 2, "splat": 2, "hybrid": 3}


def package_of(frame: FrameType | None) -> str | None:
    """Package of the nearest function of this project on the stack."""
    while frame is not None:
        path = Path(frame.f_code.co_filename)
        if path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in FLOORS:
            return path.relative_to(ROOT).parts[0]
        frame = frame.f_back
    return None


def test_no_call_of_a_frame_leads_up(backend):
    scene = load_scene(small.corner())
    renderer = Renderer(scene, rough_forest(scene))
    settings = FrameSettings(fov_a=30, fov_b=20, spp=1, camera=scene.camera.resized(48, 32))
    # The first frame fills the cache, which reports its progress.
    renderer.frame(settings)
    calls: set[tuple[str, str]] = set()

    def record(frame: FrameType, event: str, argument: object) -> None:
        if event == "call":
            called, caller = package_of(frame), package_of(frame.f_back)
            if called and caller:
                calls.add((caller, called))

    sys.setprofile(record)
    try:
        renderer.frame(settings)
    finally:
        sys.setprofile(None)
    assert ("hybrid", "compose") in calls
    assert ("hybrid", "splat") in calls
    assert {(caller, called) for caller, called in calls if FLOORS[caller] < FLOORS[called]} == set()
