"""Captured frames: traced, denoised, with geometry, in multi-channel OpenEXR files."""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError, one_line
from compose.camera.camera import Camera
from compose.image.colour import Image
from compose.image.exr import read_channels, write_channels
from pathtrace.trace.film import frame_positions
from pathtrace.trace.traced_images import TracedImage, trace_image
from pathtrace.trace.tracer import Tracer

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


# Between the seeds of the parts of one view: halves of its frame, then estimates.
_PART_SEED_STEP = 1_000_033
_HALVES = 2


def render_frame(tracer: Tracer, camera: Camera, spp: int, seed: int) -> CapturedFrame:
    """A denoised frame with `spp` samples per pixel and its geometry; same seed, same frame."""
    traced = trace_image(tracer, camera, frame_positions(camera), camera.width, spp, seed)
    return _frame(tracer, camera, traced)


def render_with_halves(
    tracer: Tracer, camera: Camera, spp: int, seed: int
) -> tuple[CapturedFrame, tuple[Image, Image]]:
    """A denoised frame, and the two independent halves of its samples.

    The halves tell how noisy the frame was before denoising, without bias (Lehtinen et al. 2018).

    Args:
        tracer: traces the scene.
        camera: the view.
        spp: samples per pixel of the frame, at least 2.
        seed: same seed, same frame and halves.

    Returns:
        The frame, and (H, W, 3) linear radiance of each half.
    """
    positions, counts = frame_positions(camera), (spp - spp // 2, spp // 2)
    one, other = (
        trace_image(tracer, camera, positions, camera.width, count, seed + number * _PART_SEED_STEP)
        for number, count in enumerate(counts)
    )
    share = np.float32(counts[1] / spp)
    mean = lambda name: (1 - share) * getattr(one, name) + share * getattr(other, name)  # noqa: E731
    traced = TracedImage(mean("radiance"), mean("albedo"), mean("normal"))
    return _frame(tracer, camera, traced), (one.radiance, other.radiance)


def render_estimates(
    tracer: Tracer, camera: Camera, counts: tuple[int, ...], seed: int, wanted: Container[int] | None = None
) -> list[TracedImage]:
    """Noisy estimates of a view, independent of its frame's samples.

    Args:
        tracer: traces the scene.
        camera: the view.
        counts: samples per pixel of each estimate.
        seed: same seed and counts, same estimates.
        wanted: those of the counts that are traced, if not all are.
    """
    return [
        trace_image(
            tracer, camera, frame_positions(camera), camera.width, count, seed + number * _PART_SEED_STEP
        )
        for number, count in enumerate(counts, start=_HALVES)
        if wanted is None or count in wanted
    ]


def geometry_of(tracer: Tracer, camera: Camera) -> tuple[Image, Image, NDArray[np.int32]]:
    """What a view shows: depth, unfolded distance and shape, (H, W) each, as of `CapturedFrame`."""
    hits = tracer.hits(camera, frame_positions(camera))
    shape = (camera.height, camera.width)
    cosine = (camera.rays(camera.pixel_centres()) @ camera.camera_to_world[:3, 2]).astype(np.float32)
    return (
        (hits.distance * cosine).reshape(shape),
        hits.unfolded.reshape(shape),
        hits.shape.reshape(shape),
    )


def _frame(tracer: Tracer, camera: Camera, traced: TracedImage) -> CapturedFrame:
    """The denoised frame of a traced image, with its geometry."""
    shading = traced.denoised(), traced.albedo, traced.normal
    return CapturedFrame(*shading, *geometry_of(tracer, camera))
