"""Videos: hybrid frames along a gaze trace, which resume, and splats alone along a way through views."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as PillowImage
from scipy.spatial.transform import Rotation, Slerp

from compose.base.errors import MOST_SEED, UserError, require_seed
from compose.camera.camera import View, camera_from_pose
from compose.eye.gaze import GazeTrace
from compose.image.colour import bytes_from_radiance
from hybrid.base.identity import require_same
from hybrid.base.progress import Steps, interrupts_between_steps
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.image_files import write_mp4, write_srgb
from hybrid.render.splat_renderer import SplatRenderer
from splat.io.tensors import load_tensors, save_tensors

# Frames of a video at most: their files are numbered by six digits.
MOST_FRAMES = 999_999
# Seconds between two saves of the fovea's history.
_EVERY = 30.0
State = dict[str, NDArray[np.generic]]


def frame_count(seconds: float, fps: int) -> int:
    """Number of frames of a video, at least 1; UserError if there would be too many."""
    if seconds * fps > MOST_FRAMES:
        raise UserError(f"{seconds:g} s at {fps} frames per second: must be {MOST_FRAMES} frames at most")
    return max(1, round(seconds * fps))


class VideoFrames:
    """The rendered frames of a video, in a folder, and the fovea's history as it was stored, if it was.

    The folder is created with the first frame. The identity is everything that the frames depend on, in types
    that JSON has. `milliseconds` are per pass, of each rendered frame. UserError if the folder is damaged, or
    holds another video.
    """

    def __init__(self, folder: Path, identity: dict[str, Any]):
        self._folder, self._identity = folder, identity
        self._state = folder / "state.safetensors"
        self._saved = time.monotonic()
        self.history: State = {}
        self.milliseconds: list[dict[str, float]] = []
        if self._state.is_file():
            tensors, found = load_tensors(self._state, "delete the folder to start again")
            self.history = {name: tensor.numpy() for name, tensor in tensors.items()}
            require_same(
                found.get("identity", {}),
                identity,
                f"{folder}: holds the beginning of a video",
                "delete it, or choose another output file",
            )
            self.milliseconds = list(found.get("milliseconds") or [])
            for number in range(len(self.milliseconds)):
                self._check(self._file(number))

    def add(
        self, image: NDArray[np.uint8], milliseconds: dict[str, float], history: Callable[[], State]
    ) -> None:
        """Stores the next frame, (H, W, 3) in sRGB, and once in a while the fovea's history."""
        write_srgb(self._file(len(self.milliseconds)), image)
        self.milliseconds.append(milliseconds)
        if time.monotonic() - self._saved > _EVERY:
            self.keep(history())

    def keep(self, history: State) -> None:
        """Stores the history after the last frame; the video resumes from there."""
        tensors = {name: torch.from_numpy(values) for name, values in history.items()}
        save_tensors(self._state, tensors, {"identity": self._identity, "milliseconds": self.milliseconds})
        self._saved = time.monotonic()

    def images(self) -> Iterator[NDArray[np.uint8]]:
        """All frames, (H, W, 3) in sRGB each."""
        for number in range(len(self.milliseconds)):
            with PillowImage.open(self._file(number)) as image:
                yield np.asarray(image)

    def remove(self) -> None:
        """Deletes the folder, once the video is complete."""
        shutil.rmtree(self._folder)

    def _check(self, file: Path) -> None:
        """Refuses to resume from a frame that is missing or damaged: its history is not known any more."""
        if not file.is_file():
            raise UserError(f"{self._folder}: frames are missing; delete it to start again")
        try:
            with PillowImage.open(file) as image:
                # Reads all of it, by way of the checksums of PNG.
                image.verify()
        except (OSError, SyntaxError, ValueError) as error:
            raise UserError(f"{file}: is damaged ({error}); delete {self._folder} to start again") from error

    def _file(self, number: int) -> Path:
        return self._folder / f"{number:06}.png"


def render_video(
    path: Path,
    renderer: Renderer,
    settings: FrameSettings,
    trace: GazeTrace,
    fps: int,
    seed: int,
    identity: dict[str, Any],
    progress: Steps,
) -> list[dict[str, float]]:
    """Renders a video along a gaze trace; the file appears complete or not at all.

    A scene that moves does so at its own speed, from the time of the settings on, and begins anew when its
    time is over. With a history, the renderer's frames are those that the window shows. The seed is that of
    the first frame; each further one has the next seed, and after MOST_SEED comes 0.

    Until it is complete, the frames are kept in a folder beside it, from which an interrupted video resumes
    if its identity is the same: everything that frames depend on, in types that JSON has.

    Returns milliseconds per pass, of each frame. UserError if the video would have too many frames, the seed
    is out of range, the folder is damaged or holds another video, or the file cannot be written.
    """
    require_seed(seed)
    count = frame_count(trace.duration, fps)
    camera, _ = settings.resolved(renderer.scene.camera)
    disc = renderer.fovea_of(settings).disc
    moving = renderer.scene.moving
    frames = VideoFrames(path.with_name(path.name + ".frames"), identity)
    disc.restore_history(camera, frames.history)
    with interrupts_between_steps() as interrupted:
        try:
            for number in range(len(frames.milliseconds), count):
                progress(number, count)
                seconds = number / fps
                time = settings.time
                if moving is not None:
                    time = (time + seconds / moving.motion.seconds) % 1
                shown = replace(settings, gaze=trace.at(seconds), time=time)
                frame = renderer.frame(shown, seed + number & MOST_SEED)
                frames.add(bytes_from_radiance(frame.composite), frame.milliseconds, disc.history_state)
                interrupted()
            # Encoding may be interrupted as well.
            frames.keep(disc.history_state())
        except KeyboardInterrupt:
            frames.keep(disc.history_state())
            raise
    progress(count, count)
    write_mp4(path, frames.images(), (camera.width, camera.height), fps)
    frames.remove()
    return frames.milliseconds


class ViewPath:
    """A way through views at equal steps, straight and evenly turning, in frames of the first's `size`."""

    def __init__(self, views: Sequence[View]):
        self.size = views[0].camera.width, views[0].camera.height
        # Of a single view, both ends are the same.
        views = views if len(views) > 1 else [*views, *views]
        cameras = [view.camera.resized(*self.size) for view in views]
        poses = np.stack([camera.camera_to_world for camera in cameras])
        numbers = [[c.fx, c.fy, c.cx, c.cy] for c in cameras]
        self._numbers = np.column_stack([poses[:, :3, 3], numbers, [view.time for view in views]])
        self._steps = np.linspace(0, 1, len(views))
        self._turn = Slerp(self._steps, Rotation.from_matrix(poses[:, :3, :3]))

    def at(self, share: float) -> View:
        """The view at a share of the way, 0 to 1."""
        x, y, z, fx, fy, cx, cy, time = (np.interp(share, self._steps, row) for row in self._numbers.T)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self._turn(share).as_matrix(), (x, y, z)
        return View(camera_from_pose(pose, *self.size, fx, fy, cx, cy), float(time))


def render_splat_video(
    path: Path,
    renderer: SplatRenderer,
    settings: FrameSettings,
    views: ViewPath,
    seconds: float,
    fps: int,
    progress: Steps,
    trace: GazeTrace | None = None,
) -> list[dict[str, float]]:
    """Renders a video that passes all views once; the file appears complete or not at all.

    The way through the views takes so many seconds; without a trace, the gaze is that of the settings.
    Returns milliseconds per pass, of each frame. UserError if there would be too many, or the file cannot be
    written.
    """
    count = frame_count(seconds, fps)
    times: list[dict[str, float]] = []

    def images() -> Iterator[NDArray[np.uint8]]:
        for number in range(count):
            progress(number, count)
            view = views.at(number / max(1, count - 1))
            gaze = settings.gaze if trace is None else trace.at(number / fps)
            frame = renderer.frame(replace(settings, camera=view.camera, time=view.time, gaze=gaze))
            times.append(frame.milliseconds)
            yield bytes_from_radiance(frame.composite)
        progress(count, count)

    write_mp4(path, images(), views.size, fps)
    return times
