"""Video files: H.264 in MP4."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.base.files import write_whole

_INSTALL = "videos require PyAV: pip install 'foveated-hybrid-renderer[demo]'"
# Constant rate factor of H.264: visually lossless.
_QUALITY = "16"


def check_video(width: int, height: int) -> None:
    """Checks, before long work begins, that a video with that frame size can be written.

    Raises:
        UserError: PyAV is not installed, or a side of the frame is odd.
    """
    try:
        import av  # noqa: F401
    except ImportError as error:
        raise UserError(_INSTALL) from error
    if width % 2 or height % 2:
        raise UserError(f"frame size {width} x {height}: width and height of a video must be even")


def write_mp4(path: Path, images: Iterator[NDArray[np.uint8]], size: tuple[int, int], fps: int) -> None:
    """Writes a video; the file appears complete or not at all.

    Args:
        path: of the file.
        images: (H, W, 3) in sRGB, one per frame.
        size: width and height in pixels, both even.
        fps: frames per second.

    Raises:
        UserError: the file cannot be written.
    """
    write_whole(path, lambda part: _encode(part, images, size, fps))


def _encode(path: Path, images: Iterator[NDArray[np.uint8]], size: tuple[int, int], fps: int) -> None:
    import av

    with av.open(str(path), "w", format="mp4") as video:
        stream = video.add_stream("h264", rate=fps, options={"crf": _QUALITY})
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        for image in images:
            video.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        video.mux(stream.encode(None))
