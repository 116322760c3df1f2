"""Images from film positions that lie in rows: radiance, its auxiliary features, and both denoised."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi
import mitsuba_oidn
import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image
from pathtrace.trace.film import FilmPositions, frame_positions, interleaved
from pathtrace.trace.tracer import Tracer

# Where all radiance is below 1e-8, OIDN finds no exposure and returns some 1e-6 of an image of its own.
# Images with a smaller peak than this are scaled by a power of two, exactly, before and after.
_LEAST_PEAK = 2.0**-8

Picture = TypeVar("Picture", "NDArray[np.float32]", "mi.TensorXf")


def denoise(radiance: Picture, albedo: Picture, normal: Picture, quick: bool = False) -> Picture:
    """(H, W, 3) radiance without Monte Carlo noise, of the same kind as what is given.

    Radiance is linear and unbounded, its pixels box-filtered and uncorrelated; albedo is clipped to 0..1;
    components of normals are in -1..1. The quicker network is for frames shown in real time.
    """
    if not isinstance(radiance, np.ndarray):
        return _denoised(radiance, albedo, normal, quick)
    # Scaled here, since kernels take the least floats for 0.
    exponent = _exponent(float(radiance.max(initial=0)))
    images = np.ldexp(radiance, -exponent) if exponent else radiance, albedo, normal
    noisy, *guides = (mi.TensorXf(np.ascontiguousarray(of, dtype=np.float32)) for of in images)
    denoised = np.array(_denoised(noisy, guides[0], guides[1], quick))
    return np.ldexp(denoised, exponent) if exponent else denoised


def _denoised(radiance: mi.TensorXf, albedo: mi.TensorXf, normal: mi.TensorXf, quick: bool) -> mi.TensorXf:
    """As `denoise`, of tensors."""
    quality = mitsuba_oidn.Quality.Fast if quick else mitsuba_oidn.Quality.High
    peak = float(dr.max(radiance.array)[0]) if radiance.array.shape[0] else 0.0
    if peak == 0:
        # OIDN shows up to 8e-4 where there is no light at all.
        return dr.zeros(type(radiance), radiance.shape)
    exponent = _exponent(peak)
    albedo = dr.clip(albedo, 0, 1)
    if exponent:
        radiance = radiance * 2.0**-exponent
    dr.eval(radiance, albedo, normal)
    # OIDN does not know of Dr.Jit's queue.
    dr.sync_thread()
    denoised = mitsuba_oidn.denoise(radiance, albedo, normal, hdr=True, quality=quality)
    return denoised * 2.0**exponent if exponent else denoised


def _exponent(peak: float) -> int:
    return math.frexp(peak)[1] if 0 < peak < _LEAST_PEAK else 0


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

    Film positions in the camera's coordinates are those of H rows from the top with W columns.
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
    """Albedo and normal, (H, W, 3) each; the pattern is the seed of the radiance, whose edges they have."""
    features = tracer.auxiliary(camera, positions, spp, pattern)
    return _image(features.albedo, columns), _image(features.normal, columns)


def _image(channels: list[Any], columns: int) -> Image:
    """(H, columns, 3) image of three (H * columns,) Dr.Jit floats."""
    return interleaved(channels).reshape(-1, columns, 3)
