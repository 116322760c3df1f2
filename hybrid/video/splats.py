"""A video of splats alone, along a way through views."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compose.eye.gaze_trace import GazeTrace
from compose.image.colour import bytes_from_radiance
from hybrid.frame.settings import FrameSettings
from hybrid.frame.splat_renderer import SplatRenderer
from hybrid.output.video import write_mp4
from hybrid.video.frames import frame_count
from hybrid.video.view_path import ViewPath


def render_splat_video(
    path: Path,
    renderer: SplatRenderer,
    settings: FrameSettings,
    views: ViewPath,
    seconds: float,
    fps: int,
    progress: Callable[[int, int], None],
    trace: GazeTrace | None = None,
) -> list[dict[str, float]]:
    """Renders a video that passes all views once; the file appears complete or not at all.

    Args:
        path: MP4 file to write.
        renderer: of the forest.
        settings: of the frames, except for camera and time.
        views: the way.
        seconds: that it takes.
        fps: frames per second.
        progress: called with frames done and frames in total.
        trace: where the viewer looks; None for the gaze of the settings.

    Returns:
        Milliseconds per pass, of each frame.

    Raises:
        UserError: the video would have too many frames, or the file cannot be written.
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

    camera = views.at(0.0).camera
    write_mp4(path, images(), (camera.width, camera.height), fps)
    return times
