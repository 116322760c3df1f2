"""EWA projection of 3D Gaussians and their colour as seen from a camera, differentiated by Dr.Jit.

Zwicker et al., EWA Splatting (2002). The low-pass filter and its compensation are those of Mip-Splatting
(Yu et al. 2024), the exponent and the determinants those of 3D Gaussian splatting (Kerbl et al. 2023).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from splat.raster.harmonics import perceptual_radiance, radiance_from_perceptual

# Variance of the pixel filter in px^2 at the pixel grid (Mip-Splatting's screen-space filter).
PIXEL_FILTER = 0.1
# A Gaussian seen edge-on has no area before it is filtered; without a floor its gradient divides by zero.
_COMPENSATION_FLOOR = 2.5e-5
# The projection is linearized no further out than at this multiple of the half field of view: beyond it,
# Gaussians beside the camera would smear over the whole frame.
_TANGENT_LIMIT = 1.3
# Gaussians nearer to the camera are not drawn.
NEAR = 0.01


@dataclass
class Splats:
    """N projected Gaussians, Dr.Jit floats of width N.

    Attributes:
        x, y: centre in pixels.
        xx, xy, yy: inverse of the 2D covariance, in 1/px^2.
        opacity: in 0..1, 0 for a Gaussian behind the near plane.
        red, green, blue: linear radiance.
        depth: along the view axis; only its order matters.
    """

    x: Any
    y: Any
    xx: Any
    xy: Any
    yy: Any
    opacity: Any
    red: Any
    green: Any
    blue: Any
    depth: Any

    def differentiable(self) -> list[Any]:
        """All parameters that the rasterizer has gradients for, in the order of declaration."""
        return [self.x, self.y, self.xx, self.xy, self.yy, self.opacity, self.red, self.green, self.blue]

    def detached(self) -> Splats:
        """The same numbers as arrays without derivatives."""
        return Splats(*(dr.detach(v, preserve_type=False) for v in (*self.differentiable(), self.depth)))


@dataclass
class Footprints:
    """N projected Gaussians before the low-pass filter, Dr.Jit floats of width N.

    Attributes:
        x, y: centre in pixels.
        xx, xy, yy: 2D covariance in px^2.
        determinant: of that covariance, in px^4, more accurate than from its entries.
        opacity: in 0..1, 0 for a Gaussian behind the near plane.
        red, green, blue: linear radiance.
        depth: along the view axis.
    """

    x: Any
    y: Any
    xx: Any
    xy: Any
    yy: Any
    determinant: Any
    opacity: Any
    red: Any
    green: Any
    blue: Any
    depth: Any


@dataclass
class Parameters:
    """The parameters of N Gaussians as Dr.Jit floats of width N.

    Attributes:
        means: three rows, world space.
        log_scales: three rows, natural logarithms of the standard deviations.
        rotations: four rows, quaternions (w, x, y, z).
        opacity_logits: one row.
        sh: for each spherical harmonic its three channels.
    """

    means: list[Any]
    log_scales: list[Any]
    rotations: list[Any]
    opacity_logits: Any
    sh: list[list[Any]]

    def leaves(self) -> list[Any]:
        """All rows, in the order of the parameter tensors' memory."""
        return [
            *self.means,
            *self.log_scales,
            *self.rotations,
            self.opacity_logits,
            *(channel for coefficient in self.sh for channel in coefficient),
        ]


def project(parameters: Parameters, camera: Camera, low_pass: Any) -> Splats:
    """Projects Gaussians onto a camera's film and filters them.

    Args:
        parameters: the Gaussians; if Dr.Jit differentiates them, it differentiates the splats.
        camera: the view.
        low_pass: variance in px^2 that is added to each 2D covariance; a float or an array (N,).
    """
    return filtered(footprints(parameters, camera), low_pass)


def filtered(raw: Footprints, low_pass: Any) -> Splats:
    """The footprints blurred by a Gaussian of that variance in px^2; each keeps its total light."""
    variance = dr.opaque(type(raw.opacity), low_pass) if isinstance(low_pass, float) else low_pass
    xx, yy = raw.xx + variance, raw.yy + variance
    determinant = raw.determinant + variance * (raw.xx + raw.yy + variance)
    inverse = dr.rcp(determinant)
    compensation = dr.sqrt(dr.maximum(raw.determinant * inverse, _COMPENSATION_FLOOR))
    return Splats(
        raw.x,
        raw.y,
        yy * inverse,
        -raw.xy * inverse,
        xx * inverse,
        raw.opacity * compensation,
        raw.red,
        raw.green,
        raw.blue,
        raw.depth,
    )


def footprints(parameters: Parameters, camera: Camera) -> Footprints:
    """Projects Gaussians onto a camera's film, without a filter."""
    number = type(parameters.opacity_logits)
    world, (fx, fy, cx, cy), (limit_x, limit_y) = _opaque(number, camera)
    eye = [dr.opaque(number, float(value)) for value in camera.position]

    mx, my, mz = parameters.means
    vx, vy, vz = (
        dr.fma(world[4 * i], mx, dr.fma(world[4 * i + 1], my, dr.fma(world[4 * i + 2], mz, world[4 * i + 3])))
        for i in range(3)
    )
    seen = vz > NEAR
    inverse_z = dr.rcp(dr.select(seen, vz, 1))
    tx, ty = vx * inverse_z, vy * inverse_z
    x, y = dr.fma(fx, tx, cx), dr.fma(fy, ty, cy)

    # Rows of J W: the projection's derivative, at a clamped tangent, times the camera's rotation.
    jx, jy = fx * inverse_z, fy * inverse_z
    cut_x, cut_y = dr.clip(tx, -limit_x, limit_x), dr.clip(ty, -limit_y, limit_y)
    row_x = [jx * (world[i] - cut_x * world[8 + i]) for i in range(3)]
    row_y = [jy * (world[4 + i] - cut_y * world[8 + i]) for i in range(3)]

    covariance = _covariance(parameters, row_x, row_y)
    opacity = dr.select(seen, dr.rcp(1 + dr.exp(-parameters.opacity_logits)), 0)

    direction = _normalized([mx - eye[0], my - eye[1], mz - eye[2]])
    red, green, blue = (
        radiance_from_perceptual(value) for value in perceptual_radiance(parameters.sh, direction)
    )
    return Footprints(x, y, *covariance, opacity, red, green, blue, dr.detach(vz))


def _covariance(parameters: Parameters, row_x: list[Any], row_y: list[Any]) -> tuple[Any, Any, Any, Any]:
    """2D covariance xx, xy, yy in px^2, and its determinant.

    Args:
        parameters: the Gaussians.
        row_x, row_y: the rows of J W.
    """
    # Rows of M = J W R S; the 2D covariance is M M^T.
    rotation = _rotation_matrix(parameters.rotations)
    scales = [dr.exp(s) for s in parameters.log_scales]
    mx_row = [sum(row_x[i] * rotation[i][j] for i in range(3)) * scales[j] for j in range(3)]
    my_row = [sum(row_y[i] * rotation[i][j] for i in range(3)) * scales[j] for j in range(3)]
    xx = sum(a * a for a in mx_row)
    yy = sum(b * b for b in my_row)
    xy = sum(a * b for a, b in zip(mx_row, my_row, strict=True))
    # Cauchy-Binet: |M M^T| as a sum of squares has none of the cancellation of xx yy - xy^2.
    determinant = sum(
        dr.square(mx_row[i] * my_row[j] - mx_row[j] * my_row[i]) for i, j in ((0, 1), (0, 2), (1, 2))
    )
    return xx, xy, yy, determinant


def view_position(arrays: Arrays, means: list[Any], camera: Camera) -> tuple[Any, Any, Any, Any]:
    """Positions of centres on the film: whether in front, x, y in pixels, and pixels per unit of length.

    The last is an upper bound over all directions for the linearized projection of `footprints`.

    Args:
        arrays: the backend's array types.
        means: three rows, world space.
        camera: the view.
    """
    world, (fx, fy, cx, cy), (limit_x, limit_y) = _opaque(arrays.plain.Float, camera)
    vx, vy, vz = (sum((world[4 * i + j] * means[j] for j in range(3)), world[4 * i + 3]) for i in range(3))
    seen = vz > NEAR
    inverse_z = dr.rcp(dr.select(seen, vz, 1))
    tx, ty = vx * inverse_z, vy * inverse_z
    tilt = dr.square(dr.minimum(dr.abs(tx), limit_x)) + dr.square(dr.minimum(dr.abs(ty), limit_y))
    spread = inverse_z * dr.sqrt(1 + tilt) * dr.maximum(fx, fy)
    return seen, dr.fma(tx, fx, cx), dr.fma(ty, fy, cy), spread


def _opaque(number: type, camera: Camera) -> tuple[list[Any], list[Any], list[Any]]:
    """World-to-camera (12, row by row), fx, fy, cx, cy, and the limits of the tangents.

    Opaque, so that one kernel serves every camera: literals would be compiled into it.
    """
    half = np.array(
        [
            max(camera.cx, camera.width - camera.cx) / camera.fx,
            max(camera.cy, camera.height - camera.cy) / camera.fy,
        ]
    )
    intrinsics = camera.fx, camera.fy, camera.cx, camera.cy
    opaque = lambda values: [dr.opaque(number, float(value)) for value in np.ravel(values)]  # noqa: E731
    return opaque(camera.world_to_camera[:3]), opaque(intrinsics), opaque(_TANGENT_LIMIT * half)


def _normalized(vector: list[Any]) -> list[Any]:
    """A vector of unit length, or of nearly none."""
    # A zero quaternion, or a Gaussian at the camera itself, has no direction but must not become NaN.
    inverse = dr.rsqrt(dr.maximum(sum(v * v for v in vector), 1e-20))
    return [v * inverse for v in vector]


def _rotation_matrix(quaternion: list[Any]) -> list[list[Any]]:
    """Rows of the rotation by a quaternion (w, x, y, z) of any length."""
    w, x, y, z = _normalized(quaternion)
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
