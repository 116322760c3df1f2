"""Captured frames as multi-channel OpenEXR files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.base.files import write_whole

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Frame:
    """One captured view.

    Attributes:
        radiance: (H, W, 3) linear, denoised.
        albedo: (H, W, 3).
        normal: (H, W, 3) shading normal in world space.
        depth: (H, W) along the view axis to the first surface, inf where nothing is hit.
        unfolded: (H, W) distance along the ray, continued through mirrors, inf where nothing is hit.
        shape: (H, W) int32 shape index, -1 where nothing is hit.
    """

    radiance: Image
    albedo: Image
    normal: Image
    depth: Image
    unfolded: Image
    shape: NDArray[np.int32]


@dataclass(frozen=True)
class Estimate:
    """A view traced with few samples, as it comes from the tracer.

    Attributes:
        radiance: (H, W, 3) linear, not denoised.
        albedo: (H, W, 3), of the same samples.
        normal: (H, W, 3), of the same samples.
    """

    radiance: Image
    albedo: Image
    normal: Image


def write_frame(path: Path, frame: Frame) -> None:
    """Writes one frame; the file appears whole or not at all."""
    single = np.float32
    channels: dict[str, Any] = {
        **_shaded(frame),
        "Z": np.ascontiguousarray(frame.depth, dtype=single),
        "unfolded.V": np.ascontiguousarray(frame.unfolded, dtype=single),
        # OpenEXR knows no signed integers: 0 is "nothing hit".
        "shape.V": (frame.shape + 1).astype(np.uint32),
    }
    _write(path, channels)


def write_estimate(path: Path, estimate: Estimate) -> None:
    """Writes one estimate; the file appears whole or not at all."""
    _write(path, _shaded(estimate))


def read_frame(path: Path) -> Frame:
    """Inverse of write_frame.

    Raises:
        UserError: the file is missing, damaged, or not a frame of a frame set.
    """
    planes = _read(path)
    try:
        return Frame(
            *_shading(planes),
            planes["Z"],
            planes["unfolded.V"],
            planes["shape.V"].astype(np.int32) - 1,
        )
    except KeyError as error:
        raise _unreadable(path, error) from error


def read_estimate(path: Path) -> Estimate:
    """Inverse of write_estimate.

    Raises:
        UserError: the file is missing, damaged, or not an estimate of a frame set.
    """
    planes = _read(path)
    try:
        return Estimate(*_shading(planes))
    except KeyError as error:
        raise _unreadable(path, error) from error


def _write(path: Path, channels: dict[str, Any]) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    write_whole(path, lambda part: OpenEXR.File(header, channels).write(str(part)))


def _read(path: Path) -> dict[str, Any]:
    try:
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
        return {name: channel.pixels for name, channel in channels.items()}
    except (OSError, RuntimeError, ValueError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> UserError:
    return UserError(f"{path}: not a readable frame ({error}); capture it again")


def _shaded(image: Frame | Estimate) -> dict[str, Any]:
    return {
        **_planes("", "RGB", image.radiance, np.float32),
        **_planes("albedo.", "RGB", image.albedo, np.float16),
        **_planes("normal.", "XYZ", image.normal, np.float16),
    }


def _shading(planes: dict[str, Any]) -> tuple[Image, Image, Image]:
    stack = lambda prefix, names: np.stack(  # noqa: E731
        [planes[prefix + n] for n in names], axis=-1
    ).astype(np.float32)
    return stack("", "RGB"), stack("albedo.", "RGB"), stack("normal.", "XYZ")


def _planes(prefix: str, names: str, image: Image, dtype: Any) -> dict[str, Any]:
    return {prefix + n: np.ascontiguousarray(image[..., i], dtype=dtype) for i, n in enumerate(names)}
