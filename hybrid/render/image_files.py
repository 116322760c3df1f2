"""Files of images: EXR with named AOVs in linear radiance, PNG in sRGB, and videos (H.264 in MP4)."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from compose.base.errors import UserError, one_line, reading
from compose.base.files import write_whole
from compose.image.colour import Image, bytes_from_radiance
from compose.image.exr import read_channels, write_channels


def check_writable(path: Path) -> None:
    """Creates a file's folder; UserError, before long work begins, if the file cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{path}: its folder cannot be created ({error.strerror})") from error
    if not os.access(path.parent, os.W_OK | os.X_OK) or path.is_dir():
        raise UserError(f"{path}: cannot be written")


def write_png(path: Path, radiance: Image) -> None:
    """Writes (H, W, 3) linear radiance as an sRGB PNG file; errors are those of `write_srgb`."""
    write_srgb(path, bytes_from_radiance(radiance))


def write_srgb(path: Path, image: NDArray[np.uint8]) -> None:
    """Writes an (H, W, 3) image that is already in sRGB as a PNG file; UserError if it cannot be written."""
    write_whole(path, lambda part: PillowImage.fromarray(image).save(part, format="PNG"))


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """An (H, W, 3) sRGB image as PNG, made quickly."""
    out = io.BytesIO()
    PillowImage.fromarray(image).save(out, "PNG", compress_level=1)
    return out.getvalue()


def jpeg_bytes(image: NDArray[np.uint8], quality: int, halves_colour: bool = False) -> bytes:
    """An (H, W, 3) sRGB image as JPEG of a quality from 1 to 100, its colour at full or half resolution."""
    out, subsampling = io.BytesIO(), "4:2:0" if halves_colour else "4:4:4"
    PillowImage.fromarray(image).save(out, "JPEG", quality=quality, subsampling=subsampling)
    return out.getvalue()


def image_of_jpeg(content: bytes, width: int, height: int) -> NDArray[np.uint8]:
    """The (H, W, 3) image of a JPEG file; ValueError if it is damaged, or of another size."""
    try:
        with PillowImage.open(io.BytesIO(content), formats=["JPEG"]) as opened:
            # Before it is decoded: a few bytes may claim any size.
            if opened.size != (width, height):
                raise ValueError(f"a picture of {opened.width} x {opened.height}, not {width} x {height}")
            return np.asarray(opened.convert("RGB"))
    except (OSError, SyntaxError, PillowImage.DecompressionBombError) as error:
        raise ValueError(f"a picture that is no JPEG ({one_line(error)})") from error


def write_exr(
    path: Path, aovs: dict[str, NDArray[np.float32]], attributes: dict[str, str] | None = None
) -> None:
    """Writes AOVs, all of one size, to one EXR file, with further entries of its header.

    Channels are name.R, .G and .B for (H, W, 3), name.V for (H, W). Viewers that ignore layer names show the
    AOV whose name is empty. UserError if the file cannot be written.
    """
    channels = {}
    for name, image in aovs.items():
        prefix = f"{name}." if name else ""
        planes = {"V": image} if image.ndim == 2 else {c: image[..., i] for i, c in enumerate("RGB")}
        for channel, plane in planes.items():
            channels[prefix + channel] = np.ascontiguousarray(plane, dtype=np.float32)
    write_channels(path, channels, attributes)


def read_exr(path: Path, size: tuple[int, int] | None = None) -> dict[str, NDArray[np.float32]]:
    """All channels of an EXR file by their full names, such as composite.R; (H, W) each.

    UserError if it is missing, damaged or not of the size (width, height) that is asked for.
    """
    with reading(path):
        return read_channels(path, size)


_INSTALL = "videos require PyAV: pip install 'foveated-hybrid-renderer[demo]'"
# Constant rate factor of H.264: visually lossless.
_QUALITY = "16"


def check_video(width: int, height: int) -> None:
    """UserError, before long work begins, if PyAV is not installed or a side of the frame is odd."""
    try:
        import av  # noqa: F401
    except ImportError as error:
        raise UserError(_INSTALL) from error
    if width % 2 or height % 2:
        raise UserError(f"frame size {width} x {height}: width and height of a video must be even")


def write_mp4(path: Path, images: Iterator[NDArray[np.uint8]], size: tuple[int, int], fps: int) -> None:
    """Writes a video of images (H, W, 3) in sRGB; the file appears complete or not at all.

    Width and height, the size, must be even. UserError if the file cannot be written.
    """
    import av

    def encode(part: Path) -> None:
        with av.open(str(part), "w", format="mp4") as video:
            stream = video.add_stream("h264", rate=fps, options={"crf": _QUALITY})
            stream.width, stream.height = size
            stream.pix_fmt = "yuv420p"
            for image in images:
                video.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
            video.mux(stream.encode(None))

    write_whole(path, encode)
