"""What a viewer saw, as a film: one frame after another along a gaze trace."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.base.files import write_whole
from compose.camera.camera import Camera
from compose.eye.gaze_trace import GazeTrace
from compose.fovea.region import Foveation
from compose.image.colour import bytes_from_radiance
from hybrid.frame.renderer import HybridRenderer
from hybrid.runtime.interrupts import interrupts_between_steps
from hybrid.video.frames import FilmFrames

_INSTALL = "films need PyAV: pip install 'foveated-hybrid-renderer[demo]'"
# Of H.264: no loss that anyone sees.
_QUALITY = "16"


def check_film(camera: Camera) -> None:
    """Before long work begins: whether a film of such frames can be written.

    Raises:
        UserError: PyAV is not installed, or a side of the frame is odd.
    """
    try:
        import av  # noqa: F401
    except ImportError as error:
        raise UserError(_INSTALL) from error
    if camera.width % 2 or camera.height % 2:
        raise UserError(f"--size {camera.width} {camera.height}: both must be even in a film")


def write_film(
    path: Path,
    renderer: HybridRenderer,
    camera: Camera,
    foveation: Foveation,
    trace: GazeTrace,
    fps: int,
    spp: int,
    seed: int,
    identity: dict[str, Any],
    progress: Callable[[int, int], None],
) -> list[dict[str, float]]:
    """Renders the frames of a trace and writes them; the file appears whole or not at all.

    Until then the frames lie in a folder beside it, so that an interrupted film goes on where it stopped.

    Args:
        path: of an MP4 file.
        renderer: of the frames; one whose fovea remembers sees what the window shows.
        camera: the view.
        foveation: its radii; the gaze is the trace's.
        trace: where the viewer looks.
        fps: frames per second.
        spp: samples per pixel and frame in the disc.
        seed: of the first frame.
        identity: of everything that the frames depend on, as JSON has it.
        progress: called with frames done, and in all.

    Returns:
        Milliseconds per pass, of each frame.

    Raises:
        UserError: the folder is damaged, or holds another film.
    """
    count = max(1, round(trace.duration * fps))
    frames = FilmFrames(path.with_name(path.name + ".frames"), identity)
    disc = renderer.fovea.disc
    disc.history = frames.history(camera) or disc.history
    with interrupts_between_steps() as interrupted:
        try:
            for number in range(len(frames.milliseconds), count):
                progress(number, count)
                at = Foveation(trace.at(number / fps), foveation.fov_a, foveation.fov_b)
                frame = renderer.frame(camera, at, spp, seed + number)
                frames.add(bytes_from_radiance(frame.composite), frame.milliseconds, disc.history)
                interrupted()
            # Also while they are encoded there may be an end to it.
            frames.keep(disc.history)
        except KeyboardInterrupt:
            frames.keep(disc.history)
            raise
    progress(count, count)
    write_whole(path, lambda part: _encode(part, camera, fps, frames.pictures()))
    frames.remove()
    return frames.milliseconds


def _encode(path: Path, camera: Camera, fps: int, pictures: Iterator[NDArray[np.uint8]]) -> None:
    import av

    with av.open(str(path), "w", format="mp4") as film:
        stream = film.add_stream("h264", rate=fps, options={"crf": _QUALITY})
        stream.width, stream.height, stream.pix_fmt = camera.width, camera.height, "yuv420p"
        for picture in pictures:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        film.mux(stream.encode(None))
