"""Captured frames: traced, denoised, with geometry, in multi-channel OpenEXR files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError, one_line
from compose.camera.camera import Camera
from compose.image.colour import Image
from compose.image.exr import read_channels, write_channels
from pathtrace.trace.film import frame_positions
from pathtrace.trace.traced_images import TracedImage, trace_frame
from pathtrace.trace.tracer import Tracer


@dataclass(frozen=True)
class CapturedFrame:
    """A captured view."""

    radiance: Image  # (H, W, 3) linear, denoised
    albedo: Image  # (H, W, 3)
    normal: Image  # (H, W, 3) shading normal in world space
    depth: Image  # (H, W) along the view axis to the first surface; inf where nothing is hit
    # (H, W) distance along the ray, continued through flat mirrors and panes; inf where nothing is hit,
    # and for the sky in a flat mirror or behind a pane.
    unfolded: Image
    shape: NDArray[np.int32]  # (H, W) int32 shape index; -1 where nothing is hit


# What the files of a view hold: of each part, the prefix, names and type of its channels.
_CHANNELS: dict[str, tuple[str, str, Any]] = {
    "radiance": ("", "RGB", np.float32),
    "albedo": ("albedo.", "RGB", np.float16),
    "normal": ("normal.", "XYZ", np.float16),
    "depth": ("", "Z", np.float32),
    "unfolded": ("unfolded.", "V", np.float32),
    # OpenEXR has no signed integers: 0 is "nothing hit".
    "shape": ("shape.", "V", np.uint32),
}


def write_frame(path: Path, content: CapturedFrame | Image) -> None:
    """Writes a frame, or (H, W, 3) linear radiance alone, atomically.

    Channels: R, G, B, Z, unfolded.V (32-bit floats), albedo.{R,G,B}, normal.{X,Y,Z} (16-bit floats) and
    shape.V (unsigned integers, shape index + 1). UserError on failure.
    """
    channels = {}
    for part, values in ({"radiance": content} if isinstance(content, np.ndarray) else vars(content)).items():
        prefix, names, dtype = _CHANNELS[part]
        planes = np.atleast_3d(values + 1 if part == "shape" else values)
        for number, name in enumerate(names):
            channels[prefix + name] = np.ascontiguousarray(planes[..., number], dtype=dtype)
    write_channels(path, channels)


def read_frame(path: Path, size: tuple[int, int] | None = None) -> CapturedFrame:
    """Reads a frame that `write_frame` wrote; UserError if it is damaged, or not `size` (width, height)."""
    return CapturedFrame(**_read(path, size, [field.name for field in fields(CapturedFrame)]))


def read_radiance(path: Path, size: tuple[int, int] | None = None) -> Image:
    """Reads (H, W, 3) radiance from a file of `write_frame`; args and raises as in `read_frame`."""
    return _read(path, size, ["radiance"])["radiance"]


def is_intact(read: Callable[[Path, tuple[int, int]], Any], file: Path, camera: Camera) -> bool:
    """Whether a file can be read as what it must be, at the size of its view, and is of use to a training."""
    try:
        found = read(file, (camera.width, camera.height))
    except UserError:
        return False
    parts = {"radiance": found} if isinstance(found, np.ndarray) else vars(found)
    # Where nothing is hit, distances are infinite.
    return all(
        np.isfinite(part).all() or (name in ("depth", "unfolded") and not np.isnan(part).any())
        for name, part in parts.items()
    )


def _read(path: Path, size: tuple[int, int] | None, parts: list[str]) -> dict[str, Any]:
    """Parts of a file, in single precision."""
    found: dict[str, Any] = {}
    try:
        channels = read_channels(path, size)
        for part in parts:
            prefix, names, _ = _CHANNELS[part]
            planes = np.stack([channels[prefix + name] for name in names], axis=-1)
            image = planes if len(names) > 1 else planes[..., 0]
            found[part] = image.astype(np.int32) - 1 if part == "shape" else image.astype(np.float32)
    except (OSError, ValueError, KeyError) as error:
        reason = f"has no channel {one_line(error)}" if isinstance(error, KeyError) else one_line(error)
        raise UserError(f"{path}: not a readable frame ({reason}); capture it again") from error
    return found


def render_frame(tracer: Tracer, camera: Camera, spp: int, seed: int) -> CapturedFrame:
    """A denoised frame with `spp` samples per pixel and its geometry; same seed, same frame."""
    return framed(trace_frame(tracer, camera, spp, seed), *geometry_of(tracer, camera))


def geometry_of(tracer: Tracer, camera: Camera) -> tuple[Image, Image, NDArray[np.int32]]:
    """What a view shows: depth, unfolded distance and shape, (H, W) each, as in `CapturedFrame`."""
    hits, size = tracer.hits(camera, frame_positions(camera)), (camera.height, camera.width)
    cosine = (camera.rays(camera.pixel_centres()) @ camera.camera_to_world[:3, 2]).astype(np.float32)
    return (hits.distance * cosine).reshape(size), hits.unfolded.reshape(size), hits.shape.reshape(size)


def framed(traced: TracedImage, depth: Image, unfolded: Image, shape: NDArray[np.int32]) -> CapturedFrame:
    """The denoised frame of a traced image, with its geometry."""
    return CapturedFrame(traced.denoised(), traced.albedo, traced.normal, depth, unfolded, shape)
