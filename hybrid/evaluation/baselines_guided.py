"""Enlarged frames that get albedo and edges from first hits at full resolution."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import constant, uploaded
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.base.compute_device import PassClock
from hybrid.evaluation.baselines_traced import Enlarged, enlargement, pooled
from pathtrace.trace.film import frame_positions, interleaved, opaque_camera

if TYPE_CHECKING:
    from pathtrace.trace.first_hit import AuxiliaryFeatures
    from pathtrace.trace.tracer import Tracer

# First hits per larger pixel, as many as of the frame's.
_FIRST_HITS = 4
# Albedo from which on radiance is divided by it.
_DARKEST = 0.01
# Of the edge-aware weights, standard deviations: in larger pixels, of albedo and of normals, and of the
# distance from the tangent plane in sides of larger pixels.
_NEAR, _ALIKE, _PARALLEL, _LEVEL = 0.6, 0.05, 0.15, 1.0
# Weight of what differs, where nothing else is near.
_LEAST = 1e-3


@dataclass(frozen=True)
class Guided(Enlarged):
    """Traces fewer, larger pixels, and enlarges them by first hits at full resolution.

    If `demodulated`, light is enlarged, radiance over albedo, and multiplied by the albedo at full
    resolution; where there is no albedo, as of metal and sky, radiance itself. If `edges`, they are
    enlarged by `edge_aware`. Like the first hits that denoising takes, those of the frame count in the
    time, but they are no paths, and so not among the rays.
    """

    demodulated: bool
    edges: bool

    def _image(self, camera: Camera, gaze: Gaze, seed: int, clock: PassClock) -> Image:
        positions, columns = self.texels(camera)
        traced = self.with_features(camera, positions, columns, seed)
        large, covered = first_hits(self.tracer, camera, seed)
        small = self.tracer.auxiliary(camera, positions, _FIRST_HITS, seed) if self.edges else None
        clock.lap("trace")
        image = traced.denoised()
        clock.lap("denoise")
        size = camera.height, camera.width
        albedo, coverage = interleaved(large.albedo).reshape(*size, 3), covered.numpy().reshape(*size, 1)
        layers = divided(image, traced.albedo, coverage) if self.demodulated else image
        if small is not None:
            layers = edge_aware(layers, small, large, camera, not self.demodulated)
        else:
            # Weights below 0, as bicubic ones, would not add up where light and radiance meet.
            layers = enlargement(layers, *size, "bilinear" if self.demodulated else "bicubic")
        image = multiplied(layers, albedo, coverage) if self.demodulated else layers
        clock.lap("enlarge")
        return image


def divided(radiance: Image, albedo: Image, coverage: NDArray[np.float32]) -> NDArray[np.float32]:
    """(h, w, 8) light and its weight, radiance and its weight, (h, w, 3) each of them but for the weights.

    Light is radiance over albedo (h, w, 3). It counts where all that is seen has albedo, by its coverage of
    the frame's pixels (H, W, 1); radiance where nothing has, far less where something, and least elsewhere.
    """
    size = radiance.shape[0], radiance.shape[1]
    lit = -pooled(-coverage, size, maxima=True) == 1
    dark = pooled(coverage, size, maxima=True) == 0
    others = np.where(dark, 1, np.where(lit, _LEAST**2, _LEAST))
    light = radiance / np.maximum(albedo, _DARKEST)
    return np.concatenate([light * lit, lit, radiance * others, others], axis=2, dtype=np.float32)


def multiplied(layers: NDArray[np.float32], albedo: Image, coverage: NDArray[np.float32]) -> Image:
    """(H, W, 3) radiance of what is `divided`, enlarged (H, W, 8), by the albedo (H, W, 3) of the frame."""
    light, lit, radiance, others = np.split(layers, (3, 4, 7), axis=2)
    rest = radiance / others
    reflected = light / np.maximum(lit, _LEAST) * np.maximum(albedo, _DARKEST * coverage)
    return np.where(lit > _LEAST, reflected + rest * (1 - coverage), rest).astype(np.float32)


def first_hits(tracer: Tracer, camera: Camera, seed: int) -> tuple[AuxiliaryFeatures, mi.Float]:
    """Auxiliary features of a frame's pixels, and the share of what each shows that has albedo."""
    positions = frame_positions(camera)
    samples = [tracer.auxiliary(camera, positions, 1, seed, number) for number in range(_FIRST_HITS)]
    albedo, normal = (
        [dr.mean(list(of)) for of in zip(*channels, strict=True)]
        for channels in zip(*((sample.albedo, sample.normal) for sample in samples), strict=True)
    )
    shows = [dr.select(dr.max(mi.Color3f(*one.albedo)) > _DARKEST, mi.Float(1), 0) for one in samples]
    coverage = dr.mean(shows)
    dr.eval(albedo, normal, coverage)
    return replace(samples[0], albedo=albedo, normal=normal), coverage


def edge_aware(
    image: Image, small: AuxiliaryFeatures, large: AuxiliaryFeatures, camera: Camera, by_albedo: bool
) -> Image:
    """(H, W, C) image enlarged to a camera's frame by joint bilateral upsampling (Kopf et al. 2007).

    Each pixel is a mean of the 3 x 3 nearest ones of (h, w, C), weighted by how near they are, and how alike
    what they show first is: normals, distance from the tangent plane and, if `by_albedo`, albedo.
    """
    rows, columns, channels = image.shape
    values = uploaded(mi.Float, np.ascontiguousarray(image, dtype=np.float32))
    row, column = _rows_columns(camera)
    down, across = (
        (mi.Float(at) + 0.5) * constant(mi.Float, count / size) - 0.5
        for at, count, size in ((row, rows, camera.height), (column, columns, camera.width))
    )
    view = opaque_camera(camera)
    eye = mi.Vector3f(*(dr.gather(mi.Float, view, axis) for axis in range(3)))
    position, normal = mi.Vector3f(*large.position), mi.Vector3f(*large.normal)
    side = dr.norm(position - eye) * constant(mi.Float, camera.height / (rows * camera.fy))
    total, sums = mi.Float(0), [mi.Float(0) for _ in range(channels)]
    last_row, last_column = (constant(mi.Int32, count - 1) for count in (rows, columns))
    for k in range(9):
        i, j = dr.round(down) + (k // 3 - 1), dr.round(across) + (k % 3 - 1)
        index = mi.UInt32(
            dr.clip(mi.Int32(i), 0, last_row) * (last_column + 1) + dr.clip(mi.Int32(j), 0, last_column)
        )
        of = lambda channels, index=index: [dr.gather(mi.Float, one, index) for one in channels]  # noqa: E731
        height = dr.dot(normal, mi.Vector3f(*of(small.position)) - position) / side
        apart = dr.square(height / _LEVEL) + _squares(of(small.normal), large.normal) / _PARALLEL**2
        if by_albedo:
            apart += _squares(of(small.albedo), large.albedo) / _ALIKE**2
        near = (dr.square(i - down) + dr.square(j - across)) / _NEAR**2
        weight = dr.exp(-0.5 * near) * (dr.exp(-0.5 * apart) + _LEAST)
        total += weight
        for c in range(channels):
            sums[c] = dr.fma(weight, dr.gather(mi.Float, values, index * channels + c), sums[c])
    means = [one / total for one in sums]
    dr.eval(means)
    flat = np.stack([one.numpy() for one in means], axis=-1)
    return flat.reshape(camera.height, camera.width, channels)


def _rows_columns(camera: Camera) -> tuple[mi.UInt32, mi.UInt32]:
    """(H * W,) row and column of each pixel."""
    width = constant(mi.UInt32, camera.width)
    pixel = dr.arange(mi.UInt32, camera.width * camera.height)
    row = pixel // width
    return row, pixel - row * width


def _squares(one: list[mi.Float], other: list[mi.Float]) -> mi.Float:
    return mi.Float(sum(dr.square(a - b) for a, b in zip(one, other, strict=True)))
