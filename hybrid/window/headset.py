"""The scene in a headset: what both eyes see as the head moves, with the disc where the viewer looks.

Whatever tells the poses of the eyes and shows their images is a `Headset`; its axes are those of OpenXR: x to
the right, y up, -z ahead, in metres. The room in which the head moves is level, begins at the scene's own
camera, and has a metre to a unit of the scene.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Array, Camera, camera_from_pose, look_at
from compose.eye.display import Display
from compose.eye.gaze import FURTHEST, Gaze
from hybrid.base.progress import no_progress
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.controls import Playback
from hybrid.window.frame_source import SceneSource
from hybrid.window.messages import Request
from hybrid.window.meter import Meter
from pathtrace.region.view_selection import upright

# From OpenXR's axes to those of cameras, and back.
_AXES = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Eye:
    """One eye.

    Attributes:
        pose: (4, 4) eye to room.
        left, right, down, up: tangents of the angles at which its view ends; left and down are negative.
    """

    pose: Array
    left: float
    right: float
    down: float
    up: float

    def camera(self, home: Camera, height: int) -> Camera:
        """What it sees in a frame of that many rows, with square pixels, if the room begins at a camera."""
        focal = height / (self.up - self.down)
        width = max(1, round(focal * (self.right - self.left)))
        pose = home.camera_to_world @ _AXES @ self.pose @ _AXES
        return camera_from_pose(pose, width, height, focal, focal, -self.left * focal, self.up * focal)


@dataclass(frozen=True)
class HeadsetFrame:
    """A frame that a headset wants.

    Attributes:
        eyes: left and right.
        gaze: (4, 4) gaze to room, ahead of which the viewer looks; None if nothing tracks the eyes.
        show: takes images of both eyes, (H, W, 3) sRGB each.
    """

    eyes: Sequence[Eye]
    gaze: Array | None
    show: Callable[[Sequence[NDArray[np.uint8]]], None]


class Headset(Protocol):
    """Tells where eyes are, and shows them images."""

    def frames(self) -> Iterator[HeadsetFrame]:
        """The frames that it wants, until it is taken off for good."""


def levelled(camera: Camera) -> Camera:
    """A camera at the same place that looks the same way, but level."""
    up, pose = upright(camera), camera.camera_to_world
    # Never along it: what is up is nearest to the camera's own.
    ahead = pose[:3, 2] - up * (pose[:3, 2] @ up)
    return camera.at(look_at(pose[:3, 3], pose[:3, 3] + ahead, up))


def gaze_in(camera: Camera, home: Camera, eye: Eye, gaze: Array | None) -> Gaze:
    """Where a viewer looks in the frame of an eye: in the direction of a gaze, or straight ahead."""
    direction = -(eye.pose if gaze is None else gaze)[:3, 2]
    ahead = (home.camera_to_world @ _AXES)[:3, :3] @ direction
    across, down, depth = camera.world_to_camera[:3, :3] @ ahead
    if depth <= 0:
        return Gaze()
    x = (camera.fx * across / depth + camera.cx) / camera.width
    y = (camera.fy * down / depth + camera.cy) / camera.height
    return Gaze(float(np.clip(x, -FURTHEST, FURTHEST)), float(np.clip(y, -FURTHEST, FURTHEST)))


def display_of(camera: Camera, luminance: float) -> Display:
    """A display as large, in degrees, as what an eye sees of it."""
    fov = 2 * np.degrees(np.arctan(camera.width / 2 / camera.fx))
    return Display(camera.width, camera.height, float(fov), luminance)


def show_in_headset(
    headset: Headset,
    source: SceneSource,
    settings: FrameSettings,
    height: int,
    playback: Playback | None = None,
    seconds: float | None = None,
) -> tuple[Meter, tuple[int, int]]:
    """Shows a scene until the headset ends, or for some seconds.

    Returns how long frames took, and width and height of the last one of an eye.

    Args:
        headset: what to show it in.
        source: frames of the scene, which may go on learning; those of one eye, the other has its own.
        settings: of both eyes, but for gaze, camera, display and time.
        height: rows of the frame of each eye; the headset scales it.
        playback: of a scene that moves.
        seconds: after the first frame.
    """
    meter = Meter(keeps_all=seconds is not None)
    eyes, home, end = [source, _beside(source)], levelled(source.camera), None
    size = 0, height
    for frame in headset.frames():
        if source.renew(no_progress):
            eyes[1] = _beside(source)
        at = time.perf_counter()
        moment = 0.0 if playback is None else playback.at(at)
        images, passes = [], dict[str, float]()
        for eye, own in zip(frame.eyes, eyes, strict=True):
            camera = eye.camera(home, height)
            gaze = gaze_in(camera, home, eye, frame.gaze)
            display = display_of(camera, settings.display.luminance)
            asked = replace(settings, gaze=gaze, camera=camera, display=display, time=moment)
            shown = own.show(Request(asked), quick=True)
            images.append(shown.image)
            size = camera.width, height
            for name, milliseconds in shown.milliseconds.items():
                passes[name] = passes.get(name, 0.0) + milliseconds
        frame.show(images)
        now = time.perf_counter()
        meter.moved(at)
        meter.shown(now, at, passes)
        end = now + seconds if seconds is not None and end is None else end
        if end is not None and now >= end:
            break
    return meter, size


def _beside(source: SceneSource) -> SceneSource:
    """Frames of the same scene and forest, with a history of their own."""
    renderer = source.renderer
    return SceneSource(LiveRenderer(renderer.scene, renderer.periphery.forest))
