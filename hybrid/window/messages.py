"""What window and renderer hand to each other: what there is to show, requests, frames, always the newest."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from queue import Empty, Queue
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from hybrid.render.frame import Frame
from hybrid.render.frame_settings import FrameSettings


@dataclass(frozen=True)
class Ready:
    """What the window needs to know before it asks for frames.

    Attributes:
        name, camera: the scene's own.
        distance: median distance to what that camera sees, in units of the scene; 1 if it sees nothing.
        layers: of the forest.
        seconds: that the scene's motion takes; None if it stands still.
    """

    name: str
    camera: Camera
    distance: float
    layers: int
    seconds: float | None = None


@dataclass(frozen=True)
class Server:
    """A scene that is elsewhere: the server that decides what is drawn of it.

    Attributes:
        address: ws:// or wss://, host and port.
        token: that the server asks for.
        authority: PEM file of certificates that the server's may be signed with; None for the system's.
    """

    address: str
    token: str = field(repr=False)
    authority: Path | None = None


class ShownView(Enum):
    """What the window shows; the values are its labels."""

    COMPOSITE = "composite"
    FOVEA = "fovea alone"
    PERIPHERY = "periphery alone"
    PATH_TRACED = "path-traced frame"
    SPLIT = "composite | path-traced"
    LEVELS = "levels and rates"
    DIFFERENCE = "difference from the path-traced frame"

    @property
    def needs_path_traced(self) -> bool:
        """Whether it shows a whole path-traced frame."""
        return self in (ShownView.PATH_TRACED, ShownView.SPLIT, ShownView.DIFFERENCE)


@dataclass(frozen=True)
class Request:
    """One frame that the window asks for.

    Attributes:
        settings: of the frame, with its camera at the window's resolution.
        view: what to show of the frame.
        gaze_time: time.perf_counter of the newest gaze movement that the settings include.
        target_fps: frames per second for which radius, samples, layers, rate and scale are chosen frame by
            frame; None leaves them as they are.
        asked: time.perf_counter of when it was asked for; says nothing about the frame.
    """

    settings: FrameSettings
    view: ShownView = ShownView.COMPOSITE
    gaze_time: float = 0.0
    target_fps: float | None = None
    asked: float = field(default_factory=time.perf_counter, compare=False)

    def same_frame(self, other: Request | None) -> bool:
        """Whether another request asks for the same frame, possibly at another time."""
        return other is not None and replace(self, gaze_time=other.gaze_time) == other


@dataclass(frozen=True)
class ShownFrame:
    """An image for the window, (H, W, 3) sRGB, and what it was made of.

    Attributes:
        request: what was asked for, with the settings that were chosen for it.
        frame: the hybrid frame behind the image.
        paths: traced for it.
        milliseconds: of each pass that was run for it, and in total; "wait", which is not part of that, from
            when it was asked for until it was begun.
        path_traced_spp: samples per pixel of the path-traced frame; 0 if the view needs none.
        finished: whether the same request would yield no better image.
        notice: a line for the viewer; empty for none.
    """

    image: NDArray[np.uint8]
    request: Request
    frame: Frame
    paths: int
    milliseconds: dict[str, float]
    path_traced_spp: int
    finished: bool
    notice: str = ""

    @property
    def spp(self) -> float:
        """Mean samples per pixel of the disc, including those of earlier frames."""
        return self.frame.fovea.samples.mean_count()


T = TypeVar("T")


class Newest(Queue[T]):
    """Holds one item; a newer one replaces it, whether or not it was taken, so that `put` never waits."""

    def _init(self, maxsize: int) -> None:
        # As the other queues of the standard library choose how they are organized.
        self.queue = deque(maxlen=1)

    def peek(self) -> T | None:
        """The newest item, which stays in the slot; None if it is empty."""
        with self.mutex:
            return self.queue[0] if self.queue else None

    def take(self, timeout: float = 0.0) -> T | None:
        """Takes the newest item out of the slot; None if it is still empty after `timeout` seconds."""
        try:
            return self.get(timeout=timeout)
        except Empty:
            return None
