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

from compose.base.arrays import constant
from compose.camera.camera import Camera
from compose.image.colour import Image
from pathtrace.trace.film import FilmPositions, frame_positions, interleaved
from pathtrace.trace.tracer import Tracer

# Added to the albedo before radiance is divided by it, so that dark surfaces do not amplify noise.
_ALBEDO_OFFSET = 0.1
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


def denoise_coarsely(radiance: mi.TensorXf, albedo: mi.TensorXf, normal: mi.TensorXf) -> mi.TensorXf:
    """`denoise` of tensors at half the resolution, which restores the albedo's detail, in half the time."""
    coarse = _halved([radiance, albedo, normal])
    # Radiance over albedo varies slowly: it loses little at half the resolution.
    light = _denoised(coarse[0], coarse[1], coarse[2], True) / (coarse[1] + _ALBEDO_OFFSET)
    dr.eval(light)
    return _doubled(light, radiance.shape) * (albedo + _ALBEDO_OFFSET)


def _halved(images: list[Any]) -> list[Any]:
    """(ceil(H / 2), ceil(W / 2), 3) means of 2 x 2 pixels; an odd last row or column is repeated."""
    height, width = images[0].shape[:2]
    shape = (height + 1) // 2, (width + 1) // 2, 3
    values = _Values(images[0], shape)
    taps = [values.at(2 * values.row + k // 2, 2 * values.column + k % 2) for k in range(4)]
    halved = [
        type(image)(0.25 * sum(dr.gather(type(image.array), image.array, tap) for tap in taps), shape)
        for image in images
    ]
    dr.eval(halved)
    return halved


def _doubled(image: mi.TensorXf, shape: tuple[int, ...]) -> mi.TensorXf:
    """(*shape) by linear interpolation of an image of half the size; the border is repeated."""
    values = _Values(image, shape)
    # Each new pixel centre lies a quarter of the way from an old one to the next.
    rows, columns = (
        ((at // 2, 0.75), (at // 2 + 2 * (at & 1) - 1, 0.25)) for at in (values.row, values.column)
    )
    mixed = sum(
        down * right * dr.gather(type(image.array), image.array, values.at(row, column))
        for row, down in rows
        for column, right in columns
    )
    return type(image)(mixed, shape)


class _Values:
    """Where values of an image (H, W, 3), one lane each, are in a source; rows and columns are signed."""

    def __init__(self, source: mi.TensorXf, shape: tuple[int, ...]):
        Int = dr.int32_array_t(type(source.array))
        width, self._height, self._width = (constant(Int, n) for n in (shape[1], *source.shape[:2]))
        index = dr.arange(Int, shape[0] * shape[1] * 3)
        pixel = index // 3
        self._channel = index - 3 * pixel
        self.row = pixel // width
        self.column = pixel - self.row * width

    def at(self, row: mi.Int32, column: mi.Int32) -> dr.ArrayBase:
        """Where in the source the values of a row and column are, its border repeated."""
        row, column = dr.clip(row, 0, self._height - 1), dr.clip(column, 0, self._width - 1)
        return dr.uint32_array_t(type(row))((row * self._width + column) * 3 + self._channel)


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
