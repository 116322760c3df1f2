"""What a viewer saw, as a film: one frame after another along a gaze trace."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compose.blend import bytes_from_radiance
from compose.errors import UserError
from compose.files import write_whole
from compose.foveation import Foveation
from compose.gaze_trace import GazeTrace
from compose.view import Camera
from hybrid.renderer import HybridRenderer

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
    progress: Callable[[int, int], None],
) -> list[dict[str, float]]:
    """Renders the frames of a trace and writes them; the file appears whole or not at all.

    Args:
        path: of an MP4 file.
        renderer: of the frames; one whose fovea remembers sees what the window shows.
        camera: the view.
        foveation: its radii; the gaze is the trace's.
        trace: where the viewer looks.
        fps: frames per second.
        spp: samples per pixel and frame in the disc.
        seed: of the first frame.
        progress: called with frames done, and in all.

    Returns:
        Milliseconds per pass, of each frame.
    """
    count = max(1, round(trace.duration * fps))
    milliseconds: list[dict[str, float]] = []

    def pictures() -> Iterator[NDArray[np.uint8]]:
        for number in range(count):
            at = Foveation(trace.at(number / fps), foveation.fov_a, foveation.fov_b)
            frame = renderer.frame(camera, at, spp, seed + number)
            milliseconds.append(frame.milliseconds)
            yield bytes_from_radiance(frame.composite)
            progress(number + 1, count)

    write_whole(path, lambda part: _encode(part, camera, fps, pictures()))
    return milliseconds


def _encode(path: Path, camera: Camera, fps: int, pictures: Iterator[NDArray[np.uint8]]) -> None:
    import av

    with av.open(str(path), "w", format="mp4") as film:
        stream = film.add_stream("h264", rate=fps, options={"crf": _QUALITY})
        stream.width, stream.height, stream.pix_fmt = camera.width, camera.height, "yuv420p"
        for picture in pictures:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        film.mux(stream.encode(None))
