"""Watches scenes that nothing was prepared for: first frame, rate while learning, changes, other places.

python -m benchmarks.watching SCENE ... [--json FILE]

The first frame is timed from the start of the process, with compiled kernels. What changes is `room`: a
dimmed lamp, a moved object, another texture. Where the viewer goes is where `room` was not learnt.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import hybrid
from benchmarks import parser_of, report
from compose.camera.camera import Camera, turned
from compose.eye.gaze import Gaze
from hybrid.base.progress import no_progress
from hybrid.preparation.forest_errors import Judges
from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.frame_source import SceneSource, prepared
from hybrid.window.learning import ShownScene
from hybrid.window.messages import Request
from pathtrace.region.neighbourhood import NearRegion
from pathtrace.scene.backend import select_backend
from pathtrace.trace.tracer import Tracer

_SIZE = 640, 480
# Seconds for which the rate is measured, and for which `room` learns before it changes.
_RATED, _LEARNT = 20.0, 90.0
# Views that judge the periphery, and their side in pixels.
_VIEWS, _SIDE = 4, 128
# Where a viewer goes: ahead, in median distances of what the scene's own camera sees, and turned, in degrees;
# and seconds after which it is looked how well that is known.
_STEP, _TURN, _STAYED = 0.2, 60.0, (0.0, 30.0, 60.0, 120.0)
# What changes, by name: a text of the scene's file and what it becomes, and the seconds given to learn it.
_CHANGES = {
    "lamp dimmed": ('value="6.2, 5.6, 4.7"', 'value="2.5, 2.3, 1.9"', 30.0),
    "object moved": (
        '<string name="filename" value="meshes/globe.ply" />',
        '<string name="filename" value="meshes/globe.ply" />\n'
        '\t\t<transform name="to_world"><translate x="-0.3" y="0.25" z="0.1" /></transform>',
        60.0,
    ),
    "texture swapped": ("textures/rug.jpg", "textures/stripes.png", 60.0),
}


def _watch(source: SceneSource, seconds: float, camera: Camera | None = None) -> list[float]:
    """Shows frames of a camera while the gaze moves, as the window does; milliseconds of each."""
    times: list[float] = []
    camera, end = (camera or source.camera).resized(*_SIZE), time.perf_counter() + seconds
    while (start := time.perf_counter()) < end:
        number = len(times) + 1
        source.renew(no_progress)
        gaze = Gaze(0.5 + 0.3 * math.sin(0.1 * number), 0.5 + 0.3 * math.sin(0.2 * number))
        source.show(Request(replace(INTERACTIVE, camera=camera, gaze=gaze)), quick=True)
        times.append(1000 * (time.perf_counter() - start))
    return times


def _source(scene: str, learns: bool) -> SceneSource:
    return prepared(ShownScene(scene), None, learns, INTERACTIVE, no_progress, lambda line: None)


def _close(source: SceneSource) -> None:
    """Closes it, and waits until the process that learns has saved what it has."""
    source.close()
    with suppress(ChildProcessError):
        while True:
            os.wait()


def _first(scene: str) -> None:
    """What a process does whose first frame is timed."""
    source = _source(scene, True)
    source.show(Request(replace(INTERACTIVE, camera=source.camera.resized(*_SIZE))), quick=True)
    print("shown", flush=True)
    _close(source)


def _first_frame_seconds(scene: str) -> float:
    start = time.perf_counter()
    words = [sys.executable, "-m", "benchmarks.watching", "--first", scene]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        return time.perf_counter() - start


def _rates(scene: str) -> dict[str, float]:
    """Frames per second without learning and beside it."""
    found = {}
    for name, learns in (("alone", False), ("learning", True)):
        source = _source(scene, learns)
        _watch(source, 3.0)
        found[name] = len(_watch(source, _RATED)) / _RATED
        _close(source)
    return found


def _judges(scene: hybrid.Scene, folder: Path, place: Camera | None = None) -> Callable[[SceneSource], float]:
    cameras = NearRegion(scene, scene.surfaces(), place).unseen_views(_VIEWS, _SIDE, _SIDE, 0)
    judges = Judges(folder, Tracer(scene), cameras, [0.0] * _VIEWS, no_progress)
    return lambda source: judges.quality(source.renderer.periphery.forest)["psnr"]


def _changes(folder: Path) -> dict[str, dict[str, float]]:
    """PSNR in dB of the periphery of `room` before changes, just after them, and once they are learnt."""
    original = Path(hybrid.__file__).parents[1] / "scenes/room"
    shutil.copytree(original, folder / "room")
    file, found = folder / "room/room.xml", {}
    text = file.read_text()
    judge = _judges(hybrid.load_scene(file), folder / "judges")
    source = _source(str(file), True)
    _watch(source, _LEARNT)
    for number, (name, (old, new, seconds)) in enumerate(_CHANGES.items()):
        before = judge(source)
        text = text.replace(old, new)
        changed = file.with_name(f"changed-{number}.xml")
        changed.write_text(text)
        judge = _judges(hybrid.load_scene(changed), folder / f"judges-{number}")
        shutil.copyfile(changed, file)
        start = time.perf_counter()
        after = judge(source)
        _watch(source, seconds - (time.perf_counter() - start))
        found[name] = {"before": before, "unlearnt": after, "seconds": seconds, "learnt": judge(source)}
    _close(source)
    return found


def _elsewhere(folder: Path) -> list[dict[str, float]]:
    """PSNR in dB at the scene's own camera and where a viewer goes, as the viewer comes, and thereafter."""
    scene = hybrid.load_scene("room")
    pose = scene.camera.camera_to_world.copy()
    pose[:3, 3] += _STEP * scene.surfaces().median_distance(scene.camera) * pose[:3, 2]
    pose[:3, :3] = turned(pose[:3, :3], _TURN, 0.0)
    place = scene.camera.at(pose)
    judges = [_judges(scene, folder / name, camera) for name, camera in (("home", None), ("place", place))]
    source = _source("room", True)
    rows: list[dict[str, float]] = []
    _watch(source, _LEARNT)
    for seconds in _STAYED:
        _watch(source, seconds - (rows[-1]["seconds"] if rows else 0.0), place)
        home, there = (judge(source) for judge in judges)
        rows.append({"seconds": seconds, "home": home, "place": there})
    _close(source)
    return rows


def main() -> None:
    """Measures, and prints or writes the figures."""
    arguments = parser_of(__doc__)
    arguments.add_argument("scenes", nargs="*")
    arguments.add_argument("--first", metavar="SCENE", help=argparse.SUPPRESS)
    given = arguments.parse_args()
    select_backend()
    if given.first:
        return _first(given.first)
    found: dict[str, Any] = {"first_frame_s": {}, "fps": {}}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        for number, scene in enumerate(given.scenes):
            os.environ["HYBRID_HOME"] = f"{folder}/{number}"
            name = Path(scene).parent.name or scene
            found["first_frame_s"][name] = _first_frame_seconds(scene)
            found["fps"][name] = _rates(scene)
        os.environ["HYBRID_HOME"] = f"{folder}/changes"
        found["changes"] = _changes(Path(folder))
        os.environ["HYBRID_HOME"] = f"{folder}/elsewhere"
        found["elsewhere"] = _elsewhere(Path(folder))
    report(found, given.json)


if __name__ == "__main__":
    main()
