"""Images from film positions that lie in rows: radiance, its auxiliary features, and both denoised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image
from pathtrace.trace.denoise import denoise
from pathtrace.trace.film import FilmPositions, frame_positions, interleaved
from pathtrace.trace.tracer import Tracer


@dataclass(frozen=True)
class TracedImage:
    """A path-traced image, (H, W, 3): linear radiance with noise, albedo, and shading normal in the world."""

    radiance: Image
    albedo: Image
    normal: Image

    def denoised(self, quick: bool = False) -> Image:
        """(H, W, 3) radiance denoised with albedo and normal, by the quicker network if `quick`."""
        return denoise(self.radiance, self.albedo, self.normal, quick)

    def mixed(self, other: TracedImage, share: float) -> TracedImage:
        """The image of these samples, which have a share of all, and of those of another image."""
        own = np.float32(share)
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return TracedImage(*(own * one + (1 - own) * another for one, another in pairs))


def trace_image(
    tracer: Tracer, camera: Camera, positions: FilmPositions, columns: int, spp: int, seed: int
) -> TracedImage:
    """Radiance with `spp` samples per pixel, and auxiliary features with as many as go with that.

    There are H * W film positions in the camera's coordinates, row by row from the top, in W columns.
    Auxiliary features guide the denoiser. Same seed, same image.
    """
    traced, features = tracer.trace_with_features(camera, positions, spp, seed)
    channels = traced.radiance, features.albedo, features.normal
    return TracedImage(*(_image(image, columns) for image in channels))


def trace_frame(tracer: Tracer, camera: Camera, spp: int, seed: int) -> TracedImage:
    """`trace_image` of all pixels of a camera's frame."""
    return trace_image(tracer, camera, frame_positions(camera), camera.width, spp, seed)


def radiance_image(
    tracer: Tracer,
    camera: Camera,
    positions: FilmPositions,
    columns: int,
    spp: int | NDArray[np.int64],
    seed: int,
) -> Image:
    """(H, W, 3) linear radiance; arguments as in `trace_image`, but `spp` may be (H * W,) counts."""
    return _image(tracer.trace(camera, positions, spp, seed).radiance, columns)


def auxiliary_images(
    tracer: Tracer, camera: Camera, positions: FilmPositions, columns: int, spp: int, pattern: int
) -> tuple[Image, Image]:
    """Albedo and normal, (H, W, 3) each, with `spp` samples per pixel; other arguments as in `trace_image`.

    The pattern is the seed of the radiance, so that both have the same sample positions and edges.
    """
    features = tracer.auxiliary(camera, positions, spp, pattern)
    return _image(features.albedo, columns), _image(features.normal, columns)


def _image(channels: list[Any], columns: int) -> Image:
    """(H, columns, 3) image of three (H * columns,) Dr.Jit floats."""
    return interleaved(channels).reshape(-1, columns, 3)
