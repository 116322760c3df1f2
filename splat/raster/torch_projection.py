"""EWA projection of batches of Gaussians onto batches of pinhole cameras, in torch, as gsplat defines it.

For `splat.rasterization`: another filter, other limits and other parameters than those of `projection`, and
gradients by the cameras, too. The source of the formulas is Zwicker et al., EWA Splatting (2002), as in Ye et
al., gsplat (2024), and for the compensation Mip-Splatting (Yu et al. 2024).

All is computed element by element on tensors (..., C, N): matrices of 3 x 3 are too small for torch's
products. As in `projection`, determinants are sums of squares, which do not cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from splat.raster.binning import MINIMUM_ALPHA
from splat.raster.projection import sh_basis

# Standard deviations that radii reach out to at most.
_REACH = 3.33
# The projection is linearized up to so many half fields of view beyond the border of the frame.
_MARGIN = 0.3
# Variance in px^2: a narrower Gaussian lies between the positions that float32 can tell apart.
_NARROWEST = 1e-12
# What the square of a compensation is at least: a root has no derivative at 0. Nothing so faint is drawn.
_FAINTEST = 1e-12
# Squares of the lengths of vectors that have a direction are larger.
_SHORTEST = 1e-24


@dataclass(frozen=True)
class Limits:
    """Which Gaussians are drawn, and how they are filtered."""

    width: int  # width, height: of the frame in pixels
    height: int
    near: float  # near, far: depths between which Gaussians are drawn
    far: float
    radius: float  # px; those that reach no further are not drawn
    variance: float  # of the filter, in px^2
    compensates: bool  # whether opacities make up for what the filter adds


@dataclass(frozen=True)
class Screen:
    """N Gaussians on the films of C cameras; (..., C, N) each, but for `means`, (..., C, N, 2).

    The other numbers of those that are not drawn have no meaning. The precisions are those of
    `projection.Splats`.
    """

    means: torch.Tensor  # centres in pixels
    x_precision: torch.Tensor
    shear: torch.Tensor
    y_precision: torch.Tensor
    opacity: torch.Tensor
    depth: torch.Tensor
    radii: torch.Tensor  # (..., C, N, 2) int32, half the visible box in pixels; 0 for one that is not drawn

    @property
    def drawn(self) -> torch.Tensor:
        """Mask (..., C, N) of those that are drawn."""
        return self.radii[..., 0] > 0

    @property
    def conics(self) -> torch.Tensor:
        """(..., C, N, 3) xx, xy and yy of the inverse covariances."""
        xy = self.x_precision * self.shear
        return torch.stack([self.x_precision, xy, torch.addcmul(self.y_precision, xy, self.shear)], dim=-1)


def project(
    means: torch.Tensor,
    axes: Sequence[Sequence[torch.Tensor]],
    opacities: torch.Tensor,
    viewmats: torch.Tensor,
    Ks: torch.Tensor,
    limits: Limits,
) -> Screen:
    """Projects Gaussians; differentiable.

    Args:
        means: (..., N, 3).
        axes: three by three (..., N), as `scaled_axes` gives them.
        opacities: (..., N).
        viewmats: (..., C, 4, 4) world to camera.
        Ks: (..., C, 3, 3) focal lengths and principal points in pixels; what else they hold is ignored.
    """
    mean = [part[..., None, :] for part in means.movedim(-1, 0).contiguous()]
    rotation = [[viewmats[..., i, j, None] for j in range(3)] for i in range(3)]
    x, y, z = (_dot(rotation[i], mean) + viewmats[..., i, 3, None] for i in range(3))
    seen = (z >= limits.near) & (z <= limits.far) & (z > 0)
    inverse_z = torch.where(seen, z, 1.0).reciprocal()
    u, row_x = _film(0, x * inverse_z, inverse_z, rotation, Ks, limits.width)
    v, row_y = _film(1, y * inverse_z, inverse_z, rotation, Ks, limits.height)

    # Rows of the projection times the Gaussian's axes; the 2D covariance is the product with its transpose.
    columns = [[part[..., None, :] for part in axis] for axis in axes]
    on_x, on_y = ([_dot(row, axis) for axis in columns] for row in (row_x, row_y))
    xx, yy, xy = _dot(on_x, on_x), _dot(on_y, on_y), _dot(on_x, on_y)
    deviation = (yy + limits.variance).clamp(min=_NARROWEST).rsqrt()
    y_precision = deviation.square()
    minors = [(on_x[i] * on_y[j] - on_x[j] * on_y[i]) * deviation for i, j in ((0, 1), (0, 2), (1, 2))]
    # Determinants over the filtered variance of y: of the Gaussian's covariance, and of the filtered one.
    before = _dot(minors, minors)
    after = before + xx * y_precision * limits.variance + limits.variance
    x_precision = after.clamp(min=_NARROWEST).reciprocal()
    opacity = opacities[..., None, :].expand(x_precision.shape)
    if limits.compensates:
        opacity = opacity * (before * x_precision).clamp(min=_FAINTEST).sqrt()
    centres = torch.stack([u, v], dim=-1)
    radii = _radii(seen, centres, torch.stack([xx, yy], dim=-1), opacity, limits)
    return Screen(centres, x_precision, -xy * y_precision, y_precision, opacity, z, radii)


def scaled_axes(quats: torch.Tensor, scales: torch.Tensor) -> list[list[torch.Tensor]]:
    """The axes of Gaussians, x, y and z (..., N) of each, as long as standard deviations.

    Of quaternions (..., N, 4), w first and of any length, and scales (..., N, 3).
    """
    w, x, y, z = _normalized(quats.unbind(-1))
    a, b, c = scales.unbind(-1)
    return [
        [a * (1 - 2 * (y * y + z * z)), a * (2 * (x * y + w * z)), a * (2 * (x * z - w * y))],
        [b * (2 * (x * y - w * z)), b * (1 - 2 * (x * x + z * z)), b * (2 * (y * z + w * x))],
        [c * (2 * (x * z + w * y)), c * (2 * (y * z - w * x)), c * (1 - 2 * (x * x + y * y))],
    ]


def harmonic_colours(
    sh: torch.Tensor, degree: int, means: torch.Tensor, viewmats: torch.Tensor
) -> torch.Tensor:
    """(..., C, N, 3) colours of Gaussians as cameras see them, not negative; differentiable.

    Of spherical harmonics (..., N, K, 3), or (..., C, N, K, 3), of which those up to a degree, 0 to 3, count.
    """
    eye = torch.linalg.inv(viewmats)[..., :3, 3]
    direction = _normalized([means[..., None, :, i] - eye[..., i, None] for i in range(3)])
    count = (degree + 1) ** 2
    constant, *others = sh_basis(count, direction)
    basis = torch.stack([torch.full_like(direction[0], constant), *others], dim=-1)
    per_camera = "c" if sh.dim() == means.dim() + 2 else ""
    total = torch.einsum(f"...cnk,...{per_camera}nkd->...cnd", basis, sh[..., :count, :])
    return (0.5 + total).clamp(min=0)


def _film(
    axis: int,
    tangent: torch.Tensor,
    inverse_z: torch.Tensor,
    rotation: list[list[torch.Tensor]],
    Ks: torch.Tensor,
    size: int,
) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """Position in pixels along x (0) or y (1) of the film, and its derivative by the world's coordinates."""
    focal, centre = Ks[..., axis, axis, None], Ks[..., axis, 2, None]
    margin = _MARGIN * 0.5 * size / focal
    cut = torch.clamp(tangent, -centre / focal - margin, (size - centre) / focal + margin)
    scale = focal * inverse_z
    return focal * tangent + centre, [scale * (rotation[axis][k] - cut * rotation[2][k]) for k in range(3)]


@torch.no_grad()
def _radii(
    seen: torch.Tensor, centres: torch.Tensor, variances: torch.Tensor, opacity: torch.Tensor, limits: Limits
) -> torch.Tensor:
    """(..., C, N, 2) int32 half the box around what shows of each Gaussian, 0 for one that is not drawn."""
    reach = (2 * (opacity / MINIMUM_ALPHA).clamp(min=1).log()).sqrt().clamp(max=_REACH)
    radii = (reach[..., None] * (variances + limits.variance).sqrt()).ceil()
    size = radii.new_tensor([limits.width, limits.height])
    inside = ((centres + radii > 0) & (centres - radii < size)).all(dim=-1)
    drawn = seen & inside & (radii > limits.radius).any(dim=-1) & radii.isfinite().all(dim=-1)
    return torch.where(drawn[..., None], radii, 0).clamp(max=2.0**30).int()


def _dot(a: Sequence[torch.Tensor], b: Sequence[torch.Tensor]) -> torch.Tensor:
    """The scalar product of vectors of three tensors."""
    return torch.addcmul(torch.addcmul(a[0] * b[0], a[1], b[1]), a[2], b[2])


def _normalized(vector: Sequence[torch.Tensor]) -> list[torch.Tensor]:
    """A vector of tensors, of unit length, or of nearly none."""
    squares = torch.stack([part * part for part in vector]).sum(dim=0)
    inverse = squares.clamp(min=_SHORTEST).rsqrt()
    return [part * inverse for part in vector]
