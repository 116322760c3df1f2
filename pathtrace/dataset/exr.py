"""Captured frames and estimates as multi-channel OpenEXR files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.base.files import write_whole
from compose.image.colour import Image
from pathtrace.trace.image import TracedImage


@dataclass(frozen=True)
class CapturedFrame:
    """A captured view.

    Attributes:
        radiance: (H, W, 3) linear, denoised.
        albedo: (H, W, 3).
        normal: (H, W, 3) shading normal in world space.
        depth: (H, W) along the view axis to the first surface; inf where nothing is hit.
        unfolded: (H, W) distance along the ray, continued through mirrors; inf where nothing is hit.
        shape: (H, W) int32 shape index; -1 where nothing is hit.
    """

    radiance: Image
    albedo: Image
    normal: Image
    depth: Image
    unfolded: Image
    shape: NDArray[np.int32]


def write_frame(path: Path, frame: CapturedFrame) -> None:
    """Writes a frame atomically.

    Channels: R, G, B, Z, unfolded.V (32-bit floats), albedo.{R,G,B}, normal.{X,Y,Z} (16-bit floats) and
    shape.V (unsigned integers, shape index + 1).

    Raises:
        UserError: the file cannot be written.
    """
    single = np.float32
    channels: dict[str, Any] = {
        **_shading_channels(frame),
        "Z": np.ascontiguousarray(frame.depth, dtype=single),
        "unfolded.V": np.ascontiguousarray(frame.unfolded, dtype=single),
        # OpenEXR has no signed integers: 0 is "nothing hit".
        "shape.V": (frame.shape + 1).astype(np.uint32),
    }
    _write(path, channels)


def write_estimate(path: Path, estimate: TracedImage) -> None:
    """Writes an image as traced, not denoised, atomically; channels as of `write_frame`, without geometry.

    Raises:
        UserError: the file cannot be written.
    """
    _write(path, _shading_channels(estimate))


def write_radiance(path: Path, radiance: Image) -> None:
    """Writes an (H, W, 3) image of linear radiance alone, atomically; channels R, G, B.

    Raises:
        UserError: the file cannot be written.
    """
    _write(path, _split("", "RGB", radiance, np.float32))


def read_frame(path: Path) -> CapturedFrame:
    """Reads what `write_frame` wrote.

    Raises:
        UserError: the file is missing, damaged, or not a frame of a frame set.
    """
    channels = _read(path)
    try:
        return CapturedFrame(
            *_shading(channels),
            channels["Z"],
            channels["unfolded.V"],
            channels["shape.V"].astype(np.int32) - 1,
        )
    except KeyError as error:
        raise _unreadable(path, error) from error


def read_estimate(path: Path) -> TracedImage:
    """Reads what `write_estimate` wrote.

    Raises:
        UserError: the file is missing, damaged, or not an estimate of a frame set.
    """
    channels = _read(path)
    try:
        return TracedImage(*_shading(channels))
    except KeyError as error:
        raise _unreadable(path, error) from error


def read_radiance(path: Path) -> Image:
    """Reads what `write_radiance` wrote.

    Raises:
        UserError: the file is missing, damaged, or has no radiance.
    """
    channels = _read(path)
    try:
        return _stacked(channels, "", "RGB")
    except KeyError as error:
        raise _unreadable(path, error) from error


def _write(path: Path, channels: dict[str, Any]) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    write_whole(path, lambda part: OpenEXR.File(header, channels).write(str(part)))


def _read(path: Path) -> dict[str, Any]:
    """Channels (H, W) by name."""
    try:
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
        return {name: channel.pixels for name, channel in channels.items()}
    except (OSError, RuntimeError, ValueError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> UserError:
    return UserError(f"{path}: not a readable frame ({error}); capture it again")


def _shading_channels(image: CapturedFrame | TracedImage) -> dict[str, Any]:
    """Channels (H, W) of radiance, albedo and normal."""
    return {
        **_split("", "RGB", image.radiance, np.float32),
        **_split("albedo.", "RGB", image.albedo, np.float16),
        **_split("normal.", "XYZ", image.normal, np.float16),
    }


def _shading(channels: dict[str, Any]) -> tuple[Image, Image, Image]:
    """Radiance, albedo and normal, (H, W, 3) each."""
    images = ("", "RGB"), ("albedo.", "RGB"), ("normal.", "XYZ")
    radiance, albedo, normal = (_stacked(channels, prefix, names) for prefix, names in images)
    return radiance, albedo, normal


def _stacked(channels: dict[str, Any], prefix: str, names: str) -> Image:
    """An image (H, W, 3) from channels (H, W)."""
    return np.stack([channels[prefix + n] for n in names], axis=-1).astype(np.float32)


def _split(prefix: str, names: str, image: Image, dtype: Any) -> dict[str, Any]:
    """An image (H, W, 3) as channels (H, W)."""
    return {prefix + n: np.ascontiguousarray(image[..., i], dtype=dtype) for i, n in enumerate(names)}
