"""Enlarged frames that get albedo and edges from first hits at full resolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from torch.nn import functional

from compose.base.arrays import constant, uploaded
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.base.compute_device import PassClock
from hybrid.evaluation.baselines_traced import Enlarged, bicubic
from pathtrace.trace.film import frame_positions, interleaved

if TYPE_CHECKING:
    from pathtrace.trace.first_hit import AuxiliaryFeatures

# First hits per pixel, of the frame and of the larger ones: a single one would have jagged edges.
_FIRST_HITS = 4
# Least albedo that radiance is divided by.
_DARKEST = 0.01
# Of the edge-aware weights, standard deviations: in larger pixels, of albedo and of normals, and of the
# distance from the tangent plane in sides of larger pixels; and the weight of what differs in all of them.
_NEAR, _ALIKE, _PARALLEL, _LEVEL = 0.6, 0.05, 0.15, 1.0
_OTHERWISE = 1e-3


@dataclass(frozen=True)
class Guided(Enlarged):
    """Traces fewer, larger pixels, and enlarges them by first hits at full resolution.

    If `demodulated`, light is enlarged, radiance over albedo, and multiplied by the albedo at full resolution;
    where a larger pixel shows hardly any albedo, as of lamps, mirrors and sky, radiance itself. If `edges`,
    this is done by `edge_aware`, else bicubically, in either case after denoising. First hits are no paths:
    like those that denoising takes, they count in the time, but not among the rays.
    """

    demodulated: bool
    edges: bool

    def _image(self, camera: Camera, gaze: Gaze, seed: int, clock: PassClock) -> Image:
        positions, columns = self.texels(camera)
        traced = self.with_features(camera, positions, columns, seed)
        large = self.tracer.auxiliary(camera, frame_positions(camera), _FIRST_HITS, seed)
        small = self.tracer.auxiliary(camera, positions, _FIRST_HITS, seed) if self.edges else None
        clock.lap("trace")
        image = traced.denoised()
        clock.lap("denoise")
        size = camera.height, camera.width
        albedo = interleaved(large.albedo).reshape(*size, 3)
        if self.demodulated:
            image = np.concatenate(divided(image, traced.albedo, albedo), axis=2)
        if small is None:
            image = bicubic(image, *size)
        else:
            image = edge_aware(image, small, large, camera, not self.demodulated)
        if self.demodulated:
            image = image[..., :3] * albedo + image[..., 3:]
        clock.lap("enlarge")
        return image


def divided(radiance: Image, albedo: Image, of_frame: Image) -> tuple[Image, Image]:
    """The light (h, w, 3) of radiance by its albedo, and the radiance that no albedo (H, W, 3) reflects."""
    planes = torch.from_numpy(of_frame).permute(2, 0, 1)[None]
    least = -functional.adaptive_max_pool2d(-planes, radiance.shape[:2])[0].permute(1, 2, 0).numpy()
    known = np.minimum(least, albedo) > _DARKEST
    return np.where(known, radiance / np.maximum(albedo, _DARKEST), 0), np.where(known, 0, radiance)


def edge_aware(
    image: Image, small: AuxiliaryFeatures, large: AuxiliaryFeatures, camera: Camera, by_albedo: bool
) -> Image:
    """(H, W, C) image enlarged to a camera's frame by joint bilateral upsampling (Kopf et al. 2007).

    Each pixel is a mean of the 3 x 3 nearest pixels of (h, w, C), weighted by how near they are, and how alike
    are normals, distances from the tangent plane and, if `by_albedo`, albedo of what both show first.
    """
    rows, columns, channels = image.shape
    values = uploaded(mi.Float, np.ascontiguousarray(image, dtype=np.float32))
    row, column = _rows_columns(camera)
    down, across = (
        (mi.Float(at) + 0.5) * constant(mi.Float, count / size) - 0.5
        for at, count, size in ((row, rows, camera.height), (column, columns, camera.width))
    )
    eye = mi.Point3f(*(constant(mi.Float, float(at)) for at in camera.camera_to_world[:3, 3]))
    position, normal = mi.Point3f(*large.position), mi.Vector3f(*large.normal)
    side = dr.norm(position - eye) * constant(mi.Float, camera.height / (rows * camera.fy))
    total, sums = mi.Float(0), [mi.Float(0) for _ in range(channels)]
    last_row, last_column = (constant(mi.Int32, count - 1) for count in (rows, columns))
    for k in range(9):
        i, j = dr.round(down) + (k // 3 - 1), dr.round(across) + (k % 3 - 1)
        index = mi.UInt32(
            dr.clip(mi.Int32(i), 0, last_row) * (last_column + 1) + dr.clip(mi.Int32(j), 0, last_column)
        )
        of = lambda channels, index=index: [dr.gather(mi.Float, one, index) for one in channels]  # noqa: E731
        height = dr.dot(normal, mi.Point3f(*of(small.position)) - position) / side
        apart = dr.square(height / _LEVEL) + _squares(of(small.normal), large.normal) / _PARALLEL**2
        if by_albedo:
            apart += _squares(of(small.albedo), large.albedo) / _ALIKE**2
        near = (dr.square(i - down) + dr.square(j - across)) / _NEAR**2
        weight = dr.exp(-0.5 * near) * (dr.exp(-0.5 * apart) + _OTHERWISE)
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


def _squares(one: list[Any], other: list[Any]) -> Any:
    return sum(dr.square(a - b) for a, b in zip(one, other, strict=True))
