"""Frames without a renderer, and views beside others."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera, turned
from compose.eye.gaze import Gaze, GazeTrace
from hybrid.base.progress import Progress
from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.messages import Newest, Ready, Request, ShownFrame
from hybrid.window.render_thread import Post
from hybrid.window.viewer import Viewer, WindowOptions

CAMERA = Camera(np.eye(4), 320, 240, 250.0, 250.0, 160.0, 120.0)
REQUEST = Request(replace(INTERACTIVE, camera=CAMERA, gaze=Gaze(0.5, 0.5), layers=(1, 3)))


def moved(camera: Camera, right: float = 0.0, degrees: float = 0.0) -> Camera:
    """A camera beside another one, turned to the right."""
    pose = camera.camera_to_world
    pose[:3, 3] += pose[:3, 0] * right
    pose[:3, :3] = turned(pose[:3, :3], degrees, 0.0)
    return camera.at(pose)


def shown(request: Request = REQUEST, image: np.ndarray | None = None, **other: Any) -> ShownFrame:
    """A grey frame of the requested size, or another image."""
    camera = request.settings.camera or CAMERA
    if image is None:
        image = np.full((camera.height, camera.width, 3), 128, dtype=np.uint8)
    samples = SimpleNamespace(mean_count=lambda: 2.5)
    frame: Any = SimpleNamespace(
        camera=camera,
        nodes_drawn=12_345,
        detail=SimpleNamespace(layers=3),
        fovea=SimpleNamespace(samples=samples),
    )
    parts: dict[str, Any] = {
        "paths": 6_789,
        "milliseconds": {"trace": 20.4, "splat": 9.6, "total": 30.0},
        "path_traced_spp": 0,
        "finished": True,
    }
    return ShownFrame(image, request, frame, **(parts | other))


class Source:
    """Grey frames at once; files without content."""

    camera, layers = CAMERA, 3

    def __init__(self, finished: bool = True):
        self.finished = finished
        self.requests: list[Request] = []
        self.threads: set[int] = set()
        # Whether something was learnt that was not taken yet.
        self.learnt = self.closed = False

    def ready(self) -> Ready:
        return Ready("box", CAMERA, 2.0, 3)

    def show(self, request: Request, quick: bool) -> ShownFrame:
        self.requests.append(request)
        self.threads.add(threading.get_ident())
        return shown(request, finished=self.finished)

    def warped(self, shown: ShownFrame, newest: Camera) -> ShownFrame:
        return shown

    def renew(self, report: Progress) -> bool:
        learnt, self.learnt = self.learnt, False
        return learnt

    def close(self) -> None:
        self.closed = True

    def save(self, png: Path) -> None:
        if not png.parent.is_dir():
            raise UserError(f"{png}: cannot be written")
        png.touch()


class Thread:
    """A render thread that does nothing by itself."""

    def __init__(self) -> None:
        self.requests: Newest[Request] = Newest()
        self.frames: Newest[ShownFrame] = Newest()
        self.files: list[Path] = []
        self.started = self.stopped = False

    def start(self, listener: Any, post: Post) -> None:
        self.started, self.listener, self.post = True, listener, post

    def stop(self) -> None:
        self.stopped = True

    def save(self, png: Path) -> None:
        self.files.append(png)
        png.touch()


def viewer(
    folder: Path,
    latency: float = 0.0,
    trace: GazeTrace | None = None,
    target_fps: float | None = None,
    bench: float | None = None,
    load: float = 0.0,
) -> Viewer:
    """Looks at a scene that is not loaded, 320 by 240 pixels, with a thread that does nothing."""
    thread: Any = Thread()
    options = WindowOptions((320, 240), latency, folder, target_fps, bench, load)
    return Viewer(thread, INTERACTIVE, trace, options)
