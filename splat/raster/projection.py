"""EWA projection of 3D Gaussians and their colour as seen from a camera, differentiated by Dr.Jit.

Zwicker et al., EWA Splatting (2002). The low-pass filter and its compensation are those of Mip-Splatting
(Yu et al. 2024), the exponent and the determinants those of 3D Gaussian splatting (Kerbl et al. 2023). So
is everything else for Gaussians that are blended by its rules (`Blending.DISPLAY`).

Any finite parameters give finite splats and gradients: no determinant is formed, which would leave float32's
range, and no terms that are subtracted can cancel where a Gaussian is long and thin. A Gaussian with a
parameter that is not a number gives a splat with one, which touches no tile.
"""

from __future__ import annotations

import atexit
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from operator import add
from typing import TYPE_CHECKING, Any, TypeVar

import drjit as dr

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.image.colour import SRGB_DARK_VALUE, SRGB_GAMMA, SRGB_OFFSET, SRGB_SCALE, SRGB_SLOPE, srgb_power
from splat.model.gaussians import SH_CUBIC, SH_DC, SH_LINEAR, SH_QUADRATIC, Blending

if TYPE_CHECKING:
    import numpy as np
    import torch
    from drjit.auto.ad import Bool, Float, Float64
    from numpy.typing import NDArray

    # Whether in front, x, y in pixels, and pixels per unit of length.
    Position = tuple[Bool, Float, Float, Float]
    Real = TypeVar("Real", Float, Float64)
    Number = TypeVar("Number", Float, Float64, torch.Tensor, NDArray[np.float64])

# Variance of the pixel filter in px^2 at the pixel grid (Mip-Splatting's screen-space filter).
PIXEL_FILTER = 0.1
# What Kerbl et al. add to each 2D covariance, in px^2, and leave the opacity as it is.
_DILATION = 0.3
# A Gaussian seen edge-on has no area before it is filtered; without a floor its gradient divides by zero.
_COMPENSATION_FLOOR = 2.5e-5
# Times the half field of view, up to which the projection is linearized: at their own tangent, Gaussians
# beside the camera would smear over the frame. Those of Kerbl et al. leave a haze where viewers stand near a
# wall.
_TANGENT_LIMITS = {Blending.LINEAR: 1.0, Blending.DISPLAY: 1.3}
# Gaussians nearer to the camera are not drawn. In their own unit of length (`Place`), whatever the size of a
# scene.
NEAR = 0.01
# Standard deviations in px: a longer axis covers any frame evenly. The square of its precision fits float32.
_LONGEST = 1e9
# Variance in px^2: a narrower Gaussian lies between the positions that float32 can tell apart.
_NARROWEST = 1e-12
# exp of it and its reciprocal fit float32; scales and opacities beyond it are over _LONGEST, or invisible.
_LARGEST_EXPONENT = 80.0
# Standard deviations at which the most opaque Gaussian falls to 1/255.
REACH = 3.33
# Vectors no longer than this have no direction.
_SHORTEST = 1e-30
# Largest radiance of a Gaussian; the sun's disc has 2e7 W / (m^2 sr). Its square, summed over a frame, fits
# float32.
LARGEST_RADIANCE = 1e12
_LARGEST_PERCEPTUAL = srgb_power(LARGEST_RADIANCE)


@dataclass
class Splats:
    """N projected Gaussians.

    At (dx, dy) px from the centre a splat's alpha is opacity exp(-q / 2) with
    q = x_precision (dx + shear dy)^2 + y_precision dy^2, the inverse of the 2D covariance as L D L^T. With
    the entries of that inverse, large terms of both signs would have to cancel where a splat is long and
    lies askew.
    """

    x: Float  # x, y: centre in pixels
    y: Float
    x_precision: Float  # inverse of the variance of x on one row of the frame, in 1/px^2
    shear: Float  # px by which the centre of a row moves to the left per row
    y_precision: Float  # inverse of the variance of y, in 1/px^2
    opacity: Float  # in 0..1, 0 for a Gaussian behind the near plane
    red: Float  # red, green, blue: what is blended, by default linear radiance
    green: Float
    blue: Float
    depth: Float  # along the view axis; only its order matters


@dataclass
class Footprints:
    """N projected Gaussians before the low-pass filter."""

    x: Float  # x, y, opacity, red, green, blue, depth: as in `Splats`
    y: Float
    xx: Float  # xx, xy, yy: 2D covariance in px^2
    xy: Float
    yy: Float
    conditional: Float  # variance of x on one row of the frame in px^2, the covariance's determinant over yy
    opacity: Float
    red: Float
    green: Float
    blue: Float
    depth: Float


@dataclass
class Parameters:
    """The parameters of N Gaussians, by rows."""

    means: list[Float]  # world space
    log_scales: list[Float]  # natural logarithms of the standard deviations
    rotations: list[Float]  # quaternions (w, x, y, z)
    opacity_logits: Float
    sh: list[list[Float]]  # for each spherical harmonic its three channels


@dataclass(frozen=True)
class CameraNumbers:
    """A camera as kernels read it, numbers of width 1 in memory: one kernel serves every camera.

    But Gaussians that are blended by other rules have kernels of their own.
    """

    rotation: list[Float64]  # of the world into the camera's axes, row by row
    eye: list[Float64]
    focal: list[Float]  # fx, fy
    centre: list[Float]  # cx, cy
    limits: list[Float]  # of the tangents
    half: list[Float]  # half the frame's width and height in pixels
    encoded: bool  # whether the rules are those of `Blending.DISPLAY`


def project(parameters: Parameters, camera: CameraNumbers, low_pass: Float | float) -> Splats:
    """Projects Gaussians onto a camera's film and filters them, as `footprints` and `filtered` do."""
    return filtered(footprints(parameters, camera), low_pass, camera.encoded)


def filtered(raw: Footprints, low_pass: Float | float, encoded: bool) -> Splats:
    """The footprints blurred by a Gaussian of that variance in px^2; each keeps its total light.

    `encoded` footprints are dilated by 0.3 px^2 already, and only what that lacks is added.
    """
    variance = dr.opaque(type(raw.opacity), low_pass) if isinstance(low_pass, float) else low_pass
    if encoded:
        variance = dr.maximum(variance - _DILATION, 0)
    y_precision = dr.rcp(raw.yy + variance)
    # Of the variance of y, the Gaussian's own share and that of the filter.
    own, added = raw.yy * y_precision, variance * y_precision
    # Determinants over yy: |V| of the Gaussian's covariance, |V| + h (xx + yy + h) of the filtered one.
    before = raw.conditional * own
    after = before + raw.xx * added + variance
    x_precision = dr.rcp(after)
    compensation = dr.sqrt(dr.maximum(before * x_precision, _COMPENSATION_FLOOR))
    opacity, rest = raw.opacity * compensation, (raw.red, raw.green, raw.blue, raw.depth)
    return Splats(raw.x, raw.y, x_precision, -raw.xy * y_precision, y_precision, opacity, *rest)


def footprints(parameters: Parameters, camera: CameraNumbers) -> Footprints:
    """Projects Gaussians onto a camera's film, without a filter but the dilation of 3D Gaussian splatting."""
    # Types with derivatives, if the parameters have those.
    number = type(parameters.opacity_logits)
    double: Any = dr.float64_array_t(number)
    rotation, eye = ([double(value) for value in values] for values in (camera.rotation, camera.eye))
    narrow = ([number(value) for value in values] for values in (camera.focal, camera.centre, camera.limits))
    (fx, fy), (cx, cy), (limit_x, limit_y) = narrow
    from_eye = _from_eye(parameters.means, eye)
    vx, vy, vz = _in_camera(rotation, from_eye)
    seen = vz > NEAR
    inverse_z = dr.rcp(dr.select(seen, vz, 1))
    tx, ty = vx * inverse_z, vy * inverse_z
    x, y = dr.fma(fx, tx, cx), dr.fma(fy, ty, cy)

    # Rows of J W: the projection's derivative, at a clamped tangent, times the camera's rotation.
    jx, jy = fx * inverse_z, fy * inverse_z
    cut_x, cut_y = dr.clip(tx, -limit_x, limit_x), dr.clip(ty, -limit_y, limit_y)
    world = [number(value) for value in rotation]
    row_x = [jx * (world[i] - cut_x * world[6 + i]) for i in range(3)]
    row_y = [jy * (world[3 + i] - cut_y * world[6 + i]) for i in range(3)]

    xx, xy, yy, conditional = _covariance(parameters, row_x, row_y)
    logits = dr.maximum(parameters.opacity_logits, -_LARGEST_EXPONENT)
    opacity = dr.select(seen, dr.rcp(1 + dr.exp(-logits)), 0)

    colour = perceptual_radiance(parameters.sh, _normalized(from_eye))
    if camera.encoded:
        # The determinant |V| + h (xx + yy + h) over yy + h, as in `filtered`.
        own = dr.rcp(yy + _DILATION)
        conditional = conditional * yy * own + xx * _DILATION * own + _DILATION
        xx, yy = xx + _DILATION, yy + _DILATION
        colour = [dr.clip(value, 0, _LARGEST_PERCEPTUAL) for value in colour]
    else:
        colour = [radiance_from_perceptual(value) for value in colour]
    red, green, blue = map(number, colour)
    return Footprints(x, y, xx, xy, yy, conditional, opacity, red, green, blue, dr.detach(vz))


def _covariance(
    parameters: Parameters, row_x: list[Float], row_y: list[Float]
) -> tuple[Float, Float, Float, Float]:
    """2D covariance xx, xy, yy in px^2, and its determinant over yy."""
    w, x, y, z = _normalized(parameters.rotations)
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    # Rows of M = J W R S; the 2D covariance is M M^T.
    mx_row, my_row = [], []
    for j, log_scale in enumerate(parameters.log_scales):
        axis_x, axis_y = (_sum(row[i] * rotation[i][j] for i in range(3)) for row in (row_x, row_y))
        longest = _LONGEST * dr.rcp(dr.detach(dr.maximum(dr.abs(axis_x), dr.abs(axis_y))))
        scale = dr.minimum(dr.exp(dr.minimum(log_scale, _LARGEST_EXPONENT)), longest)
        mx_row.append(axis_x * scale)
        my_row.append(axis_y * scale)
    xx = _sum(a * a for a in mx_row)
    yy = dr.maximum(_sum(b * b for b in my_row), _NARROWEST)
    xy = _sum(a * b for a, b in zip(mx_row, my_row, strict=True))
    # Cauchy-Binet: |M M^T| as a sum of squares has none of the cancellation of xx yy - xy^2.
    inverse = dr.rsqrt(yy)
    minors = (mx_row[i] * my_row[j] - mx_row[j] * my_row[i] for i, j in ((0, 1), (0, 2), (1, 2)))
    conditional = _sum(dr.square(minor * inverse) for minor in minors)
    return xx, xy, yy, dr.maximum(conditional, _NARROWEST)


def directional_constant(
    arrays: Arrays, sh: list[list[Float]], means: list[Float], camera: Camera
) -> list[Float]:
    """How a camera sees harmonics above the constant one, three channels each: as a constant one."""
    from_eye = map(arrays.plain.Float, _from_eye(means, camera_numbers(arrays, camera).eye))
    basis = sh_basis(len(sh) + 1, _normalized(list(from_eye)))[1:]
    return [channel / SH_DC for channel in sh_sums(sh, basis)]


def view_position(means: list[Float], view: CameraNumbers) -> Position:
    """Positions of centres on the film; pixels per unit of length are an upper bound over all directions."""
    (fx, fy), (cx, cy), (limit_x, limit_y) = view.focal, view.centre, view.limits
    vx, vy, vz = _in_camera(view.rotation, _from_eye(means, view.eye))
    seen = vz > NEAR
    inverse_z = dr.rcp(dr.select(seen, vz, 1))
    tx, ty = vx * inverse_z, vy * inverse_z
    tilt = dr.square(dr.minimum(dr.abs(tx), limit_x)) + dr.square(dr.minimum(dr.abs(ty), limit_y))
    spread = inverse_z * dr.sqrt(1 + tilt) * dr.maximum(fx, fy)
    return seen, dr.fma(tx, fx, cx), dr.fma(ty, fy, cy), spread


def distance(means: list[Float], view: CameraNumbers) -> Float:
    """Distances of centres from the eye."""
    from_eye = _from_eye(means, view.eye)
    number: Any = dr.float32_array_t(type(from_eye[0]))
    return number(dr.sqrt(_sum(part * part for part in from_eye)))


def axial(means: list[Float], view: CameraNumbers) -> Float:
    """Distances of centres from the eye along the view axis."""
    return _in_camera(view.rotation, _from_eye(means, view.eye))[2]


def may_show(means: list[Float], size: Float, view: CameraNumbers, low_pass: float) -> Bool:
    """Mask (N,) of all Gaussians that are drawn in a camera's frame, and of some beside it.

    Their sizes (N,) are longest axes, as standard deviations; the low-pass is as in `project`.
    """
    return within_frame(view_position(means, view), size, view, low_pass)


def within_frame(position: Position, size: Float, view: CameraNumbers, low_pass: Float | float) -> Bool:
    """What `may_show` returns, of positions that `view_position` found."""
    seen, x, y, spread = position
    own = dr.square(size * spread)
    variance = own + low_pass
    if view.encoded:
        variance = dr.maximum(variance, own + _DILATION)
    reach = REACH * dr.sqrt(variance)
    half_width, half_height = view.half
    within = dr.abs(x - half_width) < half_width + reach
    return seen & within & (dr.abs(y - half_height) < half_height + reach)


@lru_cache(maxsize=4)
def camera_numbers(arrays: Arrays, camera: Camera, blending: Blending = Blending.LINEAR) -> CameraNumbers:
    """Those of a camera, uploaded together, and kept, since a view has several layers."""
    across = max(camera.cx, camera.width - camera.cx) / camera.fx
    down = max(camera.cy, camera.height - camera.cy) / camera.fy
    limit = _TANGENT_LIMITS[blending]
    values = [
        *(*camera.world_to_camera[:3, :3].flat, *camera.position),
        *(camera.fx, camera.fy, camera.cx, camera.cy),
        *(limit * across, limit * down, camera.width / 2, camera.height / 2),
    ]
    found = arrays.scalars(arrays.plain.Float64, values)
    found[12:] = [arrays.plain.Float(value) for value in found[12:]]
    dr.eval(found)
    parts = found[:9], found[9:12], found[12:14], found[14:16], found[16:18], found[18:]
    return CameraNumbers(*parts, blending is Blending.DISPLAY)


# Dr.Jit complains of arrays that outlive it.
atexit.register(camera_numbers.cache_clear)


def _sum(values: Iterable[Real]) -> Real:
    """The sum, which unlike that of `sum` does not begin with 0."""
    return reduce(add, values)


def _from_eye(means: list[Float], eye: list[Float64]) -> list[Float64]:
    """Vectors from the eye to centres, in float64: in float32 they are lost far from the origin."""
    return [type(eye[0])(mean) - position for mean, position in zip(means, eye, strict=True)]


def _in_camera(rotation: list[Float64], from_eye: list[Float64]) -> list[Float]:
    x, y, z = from_eye
    number: Any = dr.float32_array_t(type(x))
    return [
        number(dr.fma(rotation[3 * i], x, dr.fma(rotation[3 * i + 1], y, rotation[3 * i + 2] * z)))
        for i in range(3)
    ]


def _normalized(vector: list[Real]) -> list[Real]:
    # Scaled first: squares of very long and short vectors leave float32's range. It needs no derivative.
    longest = reduce(dr.maximum, (dr.detach(dr.abs(v)) for v in vector))
    scale = dr.rcp(dr.select(longest > _SHORTEST, longest, 1))
    scaled = [v * scale for v in vector]
    # A zero quaternion, or a Gaussian at the camera itself, has no direction but must not become NaN.
    inverse = dr.rsqrt(dr.maximum(_sum(v * v for v in scaled), 1e-20))
    return [v * inverse for v in scaled]


def perceptual_radiance(sh: list[list[Float]], direction: list[Real]) -> list[Real]:
    """Perceptual radiance, three channels (N,), from those of each harmonic, along unit vectors x, y, z."""
    return [0.5 + channel for channel in sh_sums(sh, sh_basis(len(sh), direction))]


def sh_sums(sh: list[list[Float]], basis: list[Real]) -> list[Real]:
    """Sums of coefficients, three channels each, times their harmonics: three channels."""
    return [_sum(row[c] * value for row, value in zip(sh, basis, strict=True)) for c in range(3)]


def sh_basis(count: int, direction: Sequence[Number]) -> list[Number]:
    """The first 1, 4, 9 or 16 real spherical harmonics, with the signs of 3D Gaussian splatting's files.

    The direction is x, y, z of unit vectors, numbers of any kind; the first harmonic is a Python float.
    """
    x, y, z = direction
    basis: list = [SH_DC]
    if count > 1:
        basis += [-SH_LINEAR * y, SH_LINEAR * z, -SH_LINEAR * x]
    if count > 4:
        a, b, c = SH_QUADRATIC
        basis += [a * x * y, -a * y * z, b * (3 * z * z - 1), -a * x * z, c * (x * x - y * y)]
    if count > 9:
        a, b, c, d, e = SH_CUBIC
        basis += [
            -a * y * (3 * x * x - y * y),
            b * x * y * z,
            -c * y * (5 * z * z - 1),
            d * z * (5 * z * z - 3),
            -c * x * (5 * z * z - 1),
            e * z * (x * x - y * y),
            -a * x * (x * x - 3 * y * y),
        ]
    return basis


def radiance_from_perceptual(perceptual: Real) -> Real:
    """Inverse of the sRGB curve, continued above 1 by the same power.

    Negative values give 0, and what would exceed `LARGEST_RADIANCE` gives that: as infinity, it would turn
    every pixel near the Gaussian into a NaN.
    """
    value = dr.clip(perceptual, 0, _LARGEST_PERCEPTUAL)
    shifted = dr.maximum(value, SRGB_DARK_VALUE) + SRGB_OFFSET
    bright = dr.exp2(SRGB_GAMMA * dr.log2(shifted * (1 / SRGB_SCALE)))
    return dr.select(value <= SRGB_DARK_VALUE, value * (1 / SRGB_SLOPE), bright)
