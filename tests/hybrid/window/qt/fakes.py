"""Frames without a renderer."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.messages import Ready, Request, ShownFrame

CAMERA = Camera(np.eye(4), 320, 240, 250.0, 250.0, 160.0, 120.0)
REQUEST = Request(replace(INTERACTIVE, camera=CAMERA, gaze=Gaze(0.5, 0.5), layers=(1, 3)))


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

    def ready(self) -> Ready:
        return Ready("box", CAMERA, 2.0, 3)

    def show(self, request: Request, quick: bool) -> ShownFrame:
        self.requests.append(request)
        self.threads.add(threading.get_ident())
        return shown(request, finished=self.finished)

    def save(self, png: Path) -> None:
        if not png.parent.is_dir():
            raise UserError(f"{png}: cannot be written")
        png.touch()
