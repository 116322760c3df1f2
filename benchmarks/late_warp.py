"""What warping a late frame of the window to the viewer's newest view brings, and how long it takes.

python -m benchmarks.late_warp SCENE --forest FOREST [--json FILE]
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import hybrid
from benchmarks import measure_forest
from compose.camera.camera import Camera
from compose.image.colour import decibels
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.frame_source import SceneSource
from hybrid.window.key_bindings import Walker
from hybrid.window.messages import Request, ShownFrame

_SIZES = (640, 480), (960, 540)
# Seconds by which frames are late.
_LATE = 0.05
# Movements in a second: degrees to the right, and metres aside and ahead.
_MOVEMENTS = {
    "turning at 60 degrees/s": (60.0, 0.0, 0.0),
    "walking aside at 1 m/s": (0.0, 1.0, 0.0),
    "walking ahead at 1 m/s": (0.0, 0.0, 1.0),
}
# Directions from which a movement begins, in degrees from that of the scene's camera.
_DIRECTIONS = 0.0, 25.0
# Frames made of a view before it is shown, and warps that are timed, after some that are not.
_FRAMES, _TIMED, _WARM_UP = 4, 9, 3


def measured(scene_name: str, file: Path) -> dict[str, Any]:
    """Rows: PSNR in dB of the late and the warped frame against one from where the viewer is, and ms."""
    source = SceneSource(LiveRenderer(hybrid.load_scene(scene_name), hybrid.load_forest(file)))
    rows = []
    for width, height in _SIZES:
        for name, movement in _MOVEMENTS.items():
            for direction in _DIRECTIONS:
                right, aside, ahead = (_LATE * speed for speed in movement)
                walker = Walker(source.camera)
                walker.look(direction, 0)
                before = walker.camera(width, height)
                walker.look(right, 0)
                walker.walk(aside, 0, ahead)
                newest = walker.camera(width, height)
                expected, late = (_shown(source, camera) for camera in (newest, before))
                warps = [source.warped(late, newest) for _ in range(_WARM_UP + _TIMED)]
                times = [warp.milliseconds["warp"] for warp in warps[_WARM_UP:]]
                row = {"width": width, "height": height, "movement": name, "direction": direction}
                errors = {"late": _error(late, expected), "warped": _error(warps[-1], expected)}
                rows.append({**row, **errors, "ms": float(np.median(times))})
    return {"rows": rows}


def _shown(source: SceneSource, camera: Camera) -> ShownFrame:
    """What the window shows of a view that it has just come to."""
    source.forget()
    request = Request(replace(INTERACTIVE, camera=camera))
    return [source.show(request, quick=True) for _ in range(_FRAMES)][-1]


def _error(shown: ShownFrame, expected: ShownFrame) -> float:
    """PSNR in dB of what is on the screen."""
    difference = (shown.image.astype(np.float64) - expected.image) / 255
    return decibels(float(np.mean(difference**2)))


if __name__ == "__main__":
    measure_forest(__doc__, measured)
