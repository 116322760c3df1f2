"""Projects batches of Gaussians onto batches of cameras in torch, as gsplat does, and blends the splats.

For `splat.rasterization`: another filter, other limits and other parameters than those of `projection`, and
gradients by the cameras, too. The source of the formulas is Zwicker et al., EWA Splatting (2002), as in Ye et
al., gsplat (2024), and for the compensation Mip-Splatting (Yu et al. 2024). The kernels blend three channels
at a time.

All is computed element by element on tensors (..., C, N): matrices of 3 x 3 are too small for torch's
products. As in `projection`, determinants are sums of squares, which do not cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import torch
from torch.autograd.function import once_differentiable

from compose.base.arrays import Arrays
from compose.base.frozen import Frozen
from splat.model.gaussians import SH_DC
from splat.raster.binning import MINIMUM_ALPHA, Boxed, Candidates, TileBounds, boxed, everywhere, packed
from splat.raster.blending import Compositing, gradients_from_sums
from splat.raster.blocks import CHANNELS
from splat.raster.differentiable import (
    Context,
    PaddedRows,
    detached,
    one_after_the_other,
    state_once,
    wait_for_torch,
)
from splat.raster.parts import Parts, rasterize_parts, sums_of_parts
from splat.raster.projection import REACH, Splats, sh_basis
from splat.raster.records import Records
from splat.raster.tiles import TileGrid

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

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
    _, *others = sh_basis(count, direction)
    basis = torch.stack([torch.full_like(direction[0], SH_DC), *others], dim=-1)
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
    reach = (2 * (opacity / MINIMUM_ALPHA).clamp(min=1).log()).sqrt().clamp(max=REACH)
    radii = (reach[..., None] * (variances + limits.variance).sqrt()).ceil()
    size = radii.new_tensor([limits.width, limits.height])
    inside = ((centres + radii > 0) & (centres - radii < size)).all(dim=-1)
    drawn = seen & inside & (radii > limits.radius).any(dim=-1) & radii.isfinite().all(dim=-1)
    return torch.where(drawn[..., None], radii, 0).clamp(max=2.0**30).int()


def _dot(a: Sequence[torch.Tensor], b: Sequence[torch.Tensor]) -> torch.Tensor:
    return torch.addcmul(torch.addcmul(a[0] * b[0], a[1], b[1]), a[2], b[2])


def _normalized(vector: Sequence[torch.Tensor]) -> list[torch.Tensor]:
    squares = torch.stack([part * part for part in vector]).sum(dim=0)
    inverse = squares.clamp(min=_SHORTEST).rsqrt()
    return [part * inverse for part in vector]


# Channels that are blended at once.
AT_ONCE = CHANNELS - 1
# Numbers of a splat that its gradient is computed for, colours aside.
_SHAPE = 6
# More than the bits of any depth, as an integer.
_BEHIND_ALL = (1 << 31) - 1


@dataclass(frozen=True)
class FlatSplats:
    """N projected splats of D channels, float32; the numbers are those of `projection.Splats`."""

    centres: torch.Tensor  # (N, 2)
    x_precision: torch.Tensor  # these: (N,)
    shear: torch.Tensor
    y_precision: torch.Tensor
    opacity: torch.Tensor
    channels: torch.Tensor  # (N, D)
    depth: torch.Tensor  # more than 0 where the opacity is not 0; has no gradient


def blended(
    arrays: Arrays, splats: FlatSplats, grid: TileGrid, rules: Compositing, absolute: torch.Tensor | None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Images (H, W, D) of the channels in front of black and (H, W) of the opacity; differentiable once.

    Args:
        splats: on the device of the arrays.
        rules: how they are composited.
        absolute: (N, 2) memory into which the gradient writes the sums over pixels of the absolute values of
            their derivatives by the centres; of up to three channels only.
    """
    if not len(splats.depth):
        # An empty sum carries the gradient, which has no elements. Dr.Jit refuses arrays of none.
        black = splats.channels.new_zeros(grid.height, grid.width, splats.channels.shape[1] + 1)
        black = black + sum(tensor.sum() for tensor in vars(splats).values())
        return black[..., :-1], black[..., -1]
    return _Blend.apply(arrays, grid, rules, absolute, *vars(splats).values())


class _Blend(torch.autograd.Function):
    """The bridge: torch holds the splats and the loss, Dr.Jit blends."""

    @staticmethod
    def forward(  # type: ignore[override]  # the stub takes any
        ctx: Context,
        arrays: Arrays,
        grid: TileGrid,
        rules: Compositing,
        absolute: torch.Tensor | None,
        *tensors: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        of, UInt = FlatSplats(*tensors), arrays.plain.UInt
        device = of.depth.device
        padded = PaddedRows.of(arrays, [of.centres.T, *tensors[1:5], of.depth, of.channels.T])
        wait_for_torch(device)
        splats, found, colours = _listed(arrays, padded, everywhere(arrays, grid), grid.side)
        # By all bits of their positive depths, those that are not seen last.
        key = dr.select(found.count > 0, UInt(dr.reinterpret_array(UInt, splats.depth)), _BEHIND_ALL)
        order = arrays.argsort(key, 1 << 31)
        parts = Parts(Candidates(arrays, found, grid, None, order), rules)
        images = [rasterize_parts(arrays, parts.coloured(colour, rules))[0] for colour in colours]
        ctx.state = arrays, splats, parts, colours, images, absolute
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*tensors)
        shape = grid.padded_height, grid.padded_width, CHANNELS
        shown = [
            arrays.to_torch(image, device).reshape(shape)[: grid.height, : grid.width] for image in images
        ]
        # Copies: the backward pass still needs the buffers as they are.
        image = torch.cat([part[..., :AT_ONCE] for part in shown], dim=-1)[..., : of.channels.shape[1]]
        return image.contiguous(), shown[0][..., AT_ONCE].clone()

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Context, by_image: torch.Tensor | None, by_opacity: torch.Tensor | None
    ) -> tuple[torch.Tensor | None, ...]:
        return (None, None, None, None, *_gradients(ctx, by_image, by_opacity))


def _gradients(
    ctx: Context, by_image: torch.Tensor | None, by_opacity: torch.Tensor | None
) -> list[torch.Tensor | None]:
    arrays, splats, parts, colours, images, absolute = state_once(ctx)
    count, channels = ctx.saved_tensors[_SHAPE - 1].shape
    given = [gradient for gradient in (by_image, by_opacity) if gradient is not None]
    if not given:
        return [None] * len(ctx.saved_tensors)
    device, shape, further = given[0].device, None, []
    for k, (colour, image) in enumerate(zip(colours, images, strict=True)):
        own = None if by_image is None else by_image[..., AT_ONCE * k : AT_ONCE * (k + 1)]
        opaque = None if k else by_opacity
        rules = replace(parts.rules, by_opacity=opaque is not None, absolute=absolute is not None)
        flow = detached(arrays, _flow(parts.grid, own, opaque, device))
        wait_for_torch(device)
        sums = sums_of_parts(arrays, parts.coloured(colour, rules), image, flow)
        if absolute is not None:
            summed = [arrays.to_torch(value, device)[:count] for value in sums[_SHAPE + AT_ONCE :]]
            absolute.copy_(torch.stack(summed, dim=-1))
        shape = sums[:_SHAPE] if shape is None else [a + b for a, b in zip(shape, sums, strict=False)]
        further += sums[_SHAPE : _SHAPE + AT_ONCE]
    size = dr.width(splats.x)
    block = _by_splats(arrays, splats, shape, further, arrays.constant(size))
    rows = arrays.to_torch(block, device).reshape(-1, size)[:, :count]
    return [rows[:2].T, *rows[2:_SHAPE], rows[_SHAPE:][:channels].T, None]


def _flow(
    grid: TileGrid, by_image: torch.Tensor | None, by_opacity: torch.Tensor | None, device: torch.device
) -> torch.Tensor:
    """Derivatives by a padded image of up to three channels and the opacity."""
    flow = torch.zeros(grid.padded_height, grid.padded_width, CHANNELS, device=device)
    within = flow[: grid.height, : grid.width]
    if by_image is not None:
        within[..., : by_image.shape[-1]] = by_image
    if by_opacity is not None:
        within[..., AT_ONCE] = by_opacity
    return flow


def listed_channels(
    arrays: Arrays, padded: PaddedRows, bounds: TileBounds, side: int
) -> tuple[Splats, Boxed, list[Records]]:
    """Padded splats of the first three channels, boxed for tiles of that side, and records of each three."""
    rows = padded.on(arrays)
    shape, depth, channels = rows[:_SHAPE], rows[_SHAPE], rows[_SHAPE + 1 :]
    channels += [arrays.plain.Float(0) for _ in range(-len(channels) % AT_ONCE)]
    chunks = [channels[first : first + AT_ONCE] for first in range(0, len(channels), AT_ONCE)]
    splats = [Splats(*[*shape, *chunk, depth]) for chunk in chunks]
    found = boxed(arrays, splats[0], bounds, side)
    return splats[0], found, [found.blended, *(packed(arrays, others) for others in splats[1:])]


def gradients_of_channels(
    arrays: Arrays, splats: Splats, shape: list[Float], channels: list[Float], step: UInt
) -> Float:
    """Gradients by the numbers and channels of splats, one after the other in one array.

    From the sums of `sums_of_parts`, the first six added up over all channels; `step` is the number of
    splats, in memory.
    """
    return one_after_the_other(arrays, gradients_from_sums(splats, [*shape, *channels]), step)


_listed = Frozen(listed_channels, by_size=True)
_by_splats = Frozen(gradients_of_channels, by_size=True)
