"""A video along a gaze trace."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from compose.base.seeds import MOST_SEED, require_seed
from compose.eye.gaze_trace import GazeTrace
from compose.image.colour import bytes_from_radiance
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from hybrid.output.video import write_mp4
from hybrid.runtime.interrupts import interrupts_between_steps
from hybrid.video.frames import VideoFrames, frame_count
from pathtrace.scene.scene import Scene


def render_video(
    path: Path,
    renderer: Renderer,
    settings: FrameSettings,
    trace: GazeTrace,
    fps: int,
    seed: int,
    identity: dict[str, Any],
    progress: Callable[[int, int], None],
) -> list[dict[str, float]]:
    """Renders a video along a gaze trace; the file appears complete or not at all.

    A scene that moves does so at its own speed, and begins anew when its time is over.

    Until it is complete, its frames are kept in a folder beside it, from which an interrupted video resumes.

    Args:
        path: MP4 file to write.
        renderer: of the frames; one with a history shows what the window shows.
        settings: of the frames, except for the gaze; `time` is that of the first frame.
        trace: where the viewer looks.
        fps: frames per second.
        seed: of the first frame; each further frame has the next one, and after MOST_SEED comes 0.
        identity: everything that the frames depend on, in types that JSON has.
        progress: called with frames done and frames in total.

    Returns:
        Milliseconds per pass, of each frame.

    Raises:
        UserError: the video would have too many frames, the seed is out of range, the folder is damaged or
            holds another video, or the file cannot be written.
    """
    require_seed(seed)
    count = frame_count(trace.duration, fps)
    camera, _ = settings.resolved(renderer.scene.camera)
    disc = renderer.fovea_of(settings).disc
    frames = VideoFrames(path.with_name(path.name + ".frames"), identity)
    disc.restore_history(camera, frames.history())
    with interrupts_between_steps() as interrupted:
        try:
            for number in range(len(frames.milliseconds), count):
                progress(number, count)
                seconds = number / fps
                time = _time_after(seconds, renderer.scene, settings.time)
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


def _time_after(seconds: float, scene: Scene, start: float) -> float:
    """The time, 0 to 1, that a scene shows some seconds after a start."""
    return start if scene.moving is None else (start + seconds / scene.moving.motion.seconds) % 1
