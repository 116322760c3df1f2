"""Captured frames and estimates as multi-channel OpenEXR files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError, one_line
from compose.camera.camera import Camera
from compose.image.colour import Image
from compose.image.exr import read_channels, write_channels
from pathtrace.trace.image import TracedImage

_Content = TypeVar("_Content")


@dataclass(frozen=True)
class CapturedFrame:
    """A captured view.

    Attributes:
        radiance: (H, W, 3) linear, denoised.
        albedo: (H, W, 3).
        normal: (H, W, 3) shading normal in world space.
        depth: (H, W) along the view axis to the first surface; inf where nothing is hit.
        unfolded: (H, W) distance along the ray, continued through flat mirrors and panes; inf
            where nothing is hit, and for the sky in a flat mirror or behind a pane.
        shape: (H, W) int32 shape index; -1 where nothing is hit.
    """

    radiance: Image
    albedo: Image
    normal: Image
    depth: Image
    unfolded: Image
    shape: NDArray[np.int32]


# What the files of a view hold.
_Captured: TypeAlias = CapturedFrame | TracedImage | Image


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
    write_channels(path, channels)


def write_estimate(path: Path, estimate: TracedImage) -> None:
    """Writes an image as traced, not denoised, atomically; channels as of `write_frame`, without geometry.

    Raises:
        UserError: the file cannot be written.
    """
    write_channels(path, _shading_channels(estimate))


def write_radiance(path: Path, radiance: Image) -> None:
    """Writes an (H, W, 3) image of linear radiance alone, atomically; channels R, G, B.

    Raises:
        UserError: the file cannot be written.
    """
    write_channels(path, _split("", "RGB", radiance, np.float32))


def read_frame(path: Path, size: tuple[int, int] | None = None) -> CapturedFrame:
    """Reads what `write_frame` wrote.

    Args:
        path: of the file.
        size: width and height that the frame must have.

    Raises:
        UserError: the file is missing, damaged, of another size, or not a frame of a frame set.
    """
    return _checked(
        path,
        size,
        lambda channels: CapturedFrame(
            *_shading(channels),
            channels["Z"].astype(np.float32),
            channels["unfolded.V"].astype(np.float32),
            channels["shape.V"].astype(np.int32) - 1,
        ),
    )


def read_estimate(path: Path, size: tuple[int, int] | None = None) -> TracedImage:
    """Reads what `write_estimate` wrote.

    Args:
        path: of the file.
        size: width and height that the estimate must have.

    Raises:
        UserError: the file is missing, damaged, of another size, or not an estimate of a frame set.
    """
    return _checked(path, size, lambda channels: TracedImage(*_shading(channels)))


def read_radiance(path: Path, size: tuple[int, int] | None = None) -> Image:
    """Reads what `write_radiance` wrote.

    Args:
        path: of the file.
        size: width and height that the image must have.

    Raises:
        UserError: the file is missing, damaged, of another size, or has no radiance.
    """
    return _checked(path, size, lambda channels: _stacked(channels, "", "RGB"))


def is_intact(read: Callable[[Path, tuple[int, int]], _Captured], file: Path, camera: Camera) -> bool:
    """Whether a file can be read as what it must be, at the size of its view, and is of use to a training."""
    try:
        found = read(file, (camera.width, camera.height))
    except UserError:
        return False
    images = [found] if isinstance(found, np.ndarray) else [found.radiance, found.albedo, found.normal]
    distances = [found.depth, found.unfolded] if isinstance(found, CapturedFrame) else []
    return all(np.isfinite(one).all() for one in images) and not any(np.isnan(one).any() for one in distances)


def _checked(
    path: Path, size: tuple[int, int] | None, made_of: Callable[[dict[str, Any]], _Content]
) -> _Content:
    """What is made of the channels of a file."""
    try:
        return made_of(read_channels(path, size))
    except KeyError as error:
        raise _unreadable(path, f"has no channel {one_line(error)}") from error
    except (OSError, ValueError) as error:
        raise _unreadable(path, one_line(error)) from error


def _unreadable(path: Path, reason: str) -> UserError:
    return UserError(f"{path}: not a readable frame ({reason}); capture it again")


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
