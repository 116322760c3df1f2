"""Gaussians to image for torch: projection, binning and rasterization in one call, with the gradient.

And which Gaussians a view may show, and what each contributes to its pixels (Fov-GS, Eq. 1).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
import torch
from numpy.typing import NDArray
from torch.autograd.function import FunctionCtx, once_differentiable
from torch.nn import functional

from compose import LLVM
from compose.base.arrays import ALIGNED_FLOATS, Arrays, BackendName, constant
from compose.base.errors import UserError
from compose.base.frozen import AnySize, Frozen, capacity
from compose.camera.camera import Camera
from compose.camera.coordinate_systems import WORLD, Place
from compose.image.colour import SRGB_GAMMA, SRGB_OFFSET, SRGB_SCALE, linear_power
from splat.model.gaussians import SH_DC, Blending, Directional, Gaussians, radiance_from_perceptual
from splat.model.points import from_world
from splat.raster.binning import Boxed, Candidates, TileBounds, boxed, everywhere
from splat.raster.blending import gradients_from_sums
from splat.raster.blocks import CHANNELS
from splat.raster.parts import Parts, rasterize_parts, sums_of_parts
from splat.raster.projection import (
    NEAR,
    PIXEL_FILTER,
    CameraNumbers,
    Parameters,
    Splats,
    camera_numbers,
    may_show,
    project,
    sh_basis,
)
from splat.raster.tiles import TileGrid

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

# Which row of Gaussians is that of logits of opacity, and one that is invisible.
_LOGITS, _INVISIBLE = 10, -80.0


def seen_from(gaussians: Gaussians, eye: NDArray[np.float64]) -> Gaussians:
    """Gaussians whose constant harmonic is what they show to an eye (3,), for kernels; differentiable.

    Only those with directional harmonics change. Where all have them, kernels compute them, from `sh`.
    """
    further = gaussians.directional
    if further is None or len(further) == len(gaussians):
        return gaussians.all_turning()
    radiance = directional_radiance(further, gaussians.means, eye)
    constant = gaussians.sh[0].index_add(1, further.index, radiance / SH_DC)
    return replace(gaussians, sh=constant[None], directional=None)


def directional_radiance(further: Directional, means: torch.Tensor, eye: NDArray[np.float64]) -> torch.Tensor:
    """(3, M) what these harmonics of Gaussians at means (3, N) add to perceptual radiance at an eye (3,)."""
    # In float64, as in the projection: in float32 a difference of large numbers is lost.
    position = torch.from_numpy(np.ascontiguousarray(eye)).to(means.device)[:, None]
    from_eye = means.index_select(1, further.index).double() - position
    # What is nearer is not drawn; a Gaussian at the eye itself has no direction.
    direction = (from_eye / from_eye.norm(dim=0).clamp(min=NEAR)).to(means.dtype)
    basis = sh_basis(further.sh.shape[0] + 1, list(direction))[1:]
    if not basis:
        return means.new_zeros(3, len(further))
    return (further.sh * torch.stack(basis)[:, None]).sum(dim=0)


def render(
    gaussians: Gaussians, camera: Camera, low_pass: float = PIXEL_FILTER, place: Place = WORLD
) -> torch.Tensor:
    """Renders Gaussians; torch can differentiate the image with respect to their tensors.

    The kernels run where the tensors are: on the CPU (Dr.Jit's LLVM backend) or on a GPU (its CUDA backend).
    An image can be differentiated once, and there are no second derivatives. This fits the colours of three
    Gaussians to a grey image:

        >>> import numpy as np, torch, splat
        >>> gaussians = splat.Gaussians(
        ...     means=torch.tensor([[-0.5, 0.0, 0.5], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),  # (3, N)
        ...     log_scales=torch.full((3, 3), -1.0),
        ...     rotations=torch.tensor([[1.0], [0.0], [0.0], [0.0]]).repeat(1, 3),  # (w, x, y, z)
        ...     opacity_logits=torch.zeros(3),
        ...     sh=torch.zeros(1, 3, 3, requires_grad=True),
        ... )
        >>> pose = splat.look_at(np.array([0.0, 0.0, -3.0]), np.zeros(3), np.array([0.0, -1.0, 0.0]))
        >>> camera = splat.Camera(np.linalg.inv(pose), 64, 48, fx=60.0, fy=60.0, cx=32.0, cy=24.0)
        >>> optimizer = torch.optim.Adam([gaussians.sh], lr=0.1)
        >>> losses = []
        >>> for _ in range(20):
        ...     optimizer.zero_grad()
        ...     loss = ((splat.render(gaussians, camera) - 0.3) ** 2).mean()
        ...     loss.backward()
        ...     optimizer.step()
        ...     losses.append(loss.item())
        >>> losses[-1] < losses[0]
        True

    Args:
        gaussians: N Gaussians, all tensors on one device.
        low_pass: variance in px^2 of the filter that each Gaussian gets on the screen; 0 or more. By the
            rules of 3D Gaussian splatting (`Blending.DISPLAY`), at least 0.3.
        place: coordinates to compute in. What is nearer than 0.01 units is not drawn: for Gaussians that are
            much smaller than a room, give the size of what they show as its unit.

    Returns:
        (H, W, 3) float32 linear radiance, rows from the top.

    Raises:
        ValueError: the tensors are on several devices, or on one that is neither CPU nor CUDA; or the
            low-pass is negative or not finite.
        UserError: they are on the CPU, and there is no LLVM that Dr.Jit can use.
    """
    arrays = arrays_of("Gaussians", gaussians.every_tensor())
    if place != WORLD:
        gaussians, camera = from_world(gaussians, place), place.camera(camera)
    return render_differentiable(arrays, gaussians, camera, low_pass)


def render_differentiable(
    arrays: Arrays, gaussians: Gaussians, camera: Camera, low_pass: float = PIXEL_FILTER
) -> torch.Tensor:
    """Like `render`, with the given backend's array types."""
    if not 0 <= low_pass < float("inf"):
        raise ValueError(f"low-pass of {low_pass:g} px^2: must be finite and not negative")
    tensors = [tensor for _, tensor in seen_from(gaussians, camera.position).tensors()]
    if not len(gaussians):
        # An empty sum carries the gradient, which has no elements. Dr.Jit refuses arrays of none.
        black = gaussians.opacity_logits.new_zeros(camera.height, camera.width, 3)
        return black + sum(tensor.sum() for tensor in tensors)
    image = _Render.apply(arrays, camera, low_pass, gaussians.blending, *tensors)
    return radiance_from_perceptual(image) if gaussians.blending is Blending.DISPLAY else image


def aligned_rows(arrays: Arrays, tensors: list[torch.Tensor]) -> list[Float]:
    """The rows of tensors (..., N), without derivatives, which start where vectors are aligned.

    They share the memory of tensors whose rows all do so; others are copied, since Dr.Jit would compile other
    kernels for them. Loads by index need no alignment, but take four times as long as the copy.
    """

    def is_aligned(rows: torch.Tensor) -> bool:
        starts = rows.data_ptr(), rows.stride(0) * rows.element_size()
        return rows.stride(1) == 1 and not any(start % (4 * ALIGNED_FLOATS) for start in starts)

    count = tensors[0].shape[-1]
    flat = [tensor.detach().reshape(-1, count) for tensor in tensors]
    others = [k for k, rows in enumerate(flat) if not is_aligned(rows)]
    if others:
        stride = -(-count // ALIGNED_FLOATS) * ALIGNED_FLOATS
        sizes = [len(flat[k]) for k in others]
        copy = torch.empty(sum(sizes), stride, device=flat[0].device)[:, :count]
        torch.cat([flat[k] for k in others], out=copy)
        for k, part in zip(others, copy.split(sizes), strict=True):
            flat[k] = part
    return [detached(arrays, row) for rows in flat for row in rows]


def detached(arrays: Arrays, tensor: torch.Tensor) -> Float:
    """A tensor's elements, flat, without derivatives."""
    return dr.detach(arrays.from_torch(tensor), preserve_type=False)


def arrays_of(what: str, tensors: Iterable[torch.Tensor]) -> Arrays:
    """Array types for the device that all tensors are on.

    ValueError if they are on several devices, or on one that is neither CPU nor CUDA; UserError if they
    are on the CPU, and there is no LLVM that Dr.Jit can use.
    """
    devices = {tensor.device for tensor in tensors}
    if len(devices) > 1:
        raise ValueError(f"{what} on {', '.join(sorted(map(str, devices)))}: must be on one device")
    kind = devices.pop().type
    if kind not in ("cpu", "cuda"):
        raise ValueError(f"{what} on {kind}: must be on cpu or cuda")
    return _arrays("llvm" if kind == "cpu" else "cuda")


@lru_cache
def _arrays(backend: BackendName) -> Arrays:
    # Without LLVM, Dr.Jit would end the process.
    if backend == "llvm" and isinstance(LLVM, UserError):
        raise LLVM
    return Arrays(backend)


class Context(FunctionCtx):
    """What torch keeps of a function for its gradient."""

    saved_tensors: tuple[torch.Tensor, ...]
    state: tuple | None


class _Render(torch.autograd.Function):
    """The bridge: torch holds parameters and loss, Dr.Jit computes what is blended, and gradients."""

    @staticmethod
    def forward(  # type: ignore[override]  # the stub takes any
        ctx: Context,
        arrays: Arrays,
        camera: Camera,
        low_pass: float,
        blending: Blending,
        *tensors: torch.Tensor,
    ) -> torch.Tensor:
        # Of tensors that may have other shapes than when they were made Gaussians.
        padded = PaddedRows.of(arrays, [tensor for _, tensor in Gaussians(*tensors).tensors()])
        wait_for_torch(tensors[0].device)
        grid = TileGrid(camera.width, camera.height)
        view = camera_numbers(arrays, camera, blending), constant(arrays.plain.Float, low_pass)
        splats, found = _projected(arrays, padded, *view, everywhere(arrays, grid), grid.side)
        parts = Parts(Candidates.of(arrays, splats, grid, found))
        (image,) = rasterize_parts(arrays, parts)
        ctx.state = (arrays, padded, view, splats, parts, image)
        # The gradient reads the tensors again: torch refuses to go on if they have changed meanwhile.
        ctx.save_for_backward(*tensors)
        shape = grid.padded_height, grid.padded_width, CHANNELS
        buffer = arrays.to_torch(image, tensors[0].device).reshape(shape)
        # A copy: the backward pass still needs the buffer as it is.
        return buffer[: camera.height, : camera.width, :3].clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Context, gradient: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        arrays, padded, view, splats, parts, image = state_once(ctx)
        shapes = [tensor.shape for tensor in ctx.saved_tensors]
        grid = parts.grid
        beyond = (0, CHANNELS - 3, 0, grid.padded_width - grid.width, 0, grid.padded_height - grid.height)
        flow = detached(arrays, functional.pad(gradient, beyond))
        wait_for_torch(gradient.device)
        sums = sums_of_parts(arrays, parts, image, flow)
        block = _by_parameters(arrays, padded, *view, splats, sums, arrays.constant(padded.size))
        found = arrays.to_torch(block, gradient.device).reshape(-1, padded.size)[:, : shapes[0][-1]]
        sizes = [shape.numel() // shape[-1] for shape in shapes]
        results = [part.reshape(s) for part, s in zip(found.split(sizes), shapes, strict=True)]
        return (None, None, None, None, *results)


def state_once(ctx: Context) -> tuple:
    """What `forward` left as `state`, the arrays first; RuntimeError if a gradient took it before."""
    state, ctx.state = ctx.state, None
    # Dr.Jit's graph is gone after one traversal.
    if state is None:
        raise RuntimeError("this image was differentiated already: render it again")
    # On a card, torch calls this in a thread of its own, which may only use arrays of an earlier scope.
    dr.detail.new_scope(dr.backend_v(state[0].plain.Float))
    return state


def parameters_of(rows: list[Float]) -> Parameters:
    """Parameters from their rows, in the order of the parameter tensors' memory."""
    means, log_scales, rotations, sh = rows[:3], rows[3:6], rows[6:10], rows[11:]
    return Parameters(means, log_scales, rotations, rows[10], [sh[k : k + 3] for k in range(0, len(sh), 3)])


@dataclass(frozen=True)
class PaddedRows:
    """Rows of N Gaussians or splats, to be followed by zeros: trainings render other numbers in each view."""

    rows: AnySize  # (N,) each, in the order of the parameter tensors' memory
    count: UInt  # N
    size: int  # more than N

    @staticmethod
    def of(arrays: Arrays, tensors: list[torch.Tensor]) -> PaddedRows:
        """The rows of tensors (..., N)."""
        count = tensors[0].shape[-1]
        rows = AnySize(aligned_rows(arrays, tensors))
        return PaddedRows(rows, arrays.constant(count), capacity(count + 1))

    def on(self, arrays: Arrays) -> list[Float]:
        """The rows, `size` wide."""
        lane = dr.arange(arrays.plain.UInt, self.size)
        known = lane < self.count
        return [dr.gather(type(row), row, lane, known) for row in self.rows.arrays]


def _rows_of_gaussians(arrays: Arrays, padded: PaddedRows) -> list[Float]:
    rows = padded.on(arrays)
    known = dr.arange(arrays.plain.UInt, padded.size) < padded.count
    rows[_LOGITS] = dr.select(known, rows[_LOGITS], _INVISIBLE)
    return rows


def projected_splats(
    arrays: Arrays, padded: PaddedRows, view: CameraNumbers, low_pass: Float, bounds: TileBounds, side: int
) -> tuple[Splats, Boxed]:
    """Splats of padded Gaussians, and those as boxed for tiles of that side."""
    splats = project(parameters_of(_rows_of_gaussians(arrays, padded)), view, low_pass)
    return splats, boxed(arrays, splats, bounds, side)


def gradients_of_rows(
    arrays: Arrays,
    padded: PaddedRows,
    view: CameraNumbers,
    low_pass: Float,
    splats: Splats,
    sums: list[Float],
    step: UInt,
) -> Float:
    """Gradients by the rows of padded Gaussians, one after the other in one array.

    `sums` are those of `sums_of_parts`, and `step` is the size in memory; all else is as it was projected.
    """
    leaves = [arrays.ad.Float(row) for row in _rows_of_gaussians(arrays, padded)]
    dr.enable_grad(leaves)
    # The rasterizer has gradients for all but the depths, which come last.
    *outputs, _ = vars(project(parameters_of(leaves), view, low_pass)).values()
    for value, by_value in zip(outputs, gradients_from_sums(splats, sums), strict=True):
        dr.accum_grad(value, by_value)
    dr.enqueue(dr.ADMode.Backward, outputs)
    dr.traverse(dr.ADMode.Backward)
    return one_after_the_other(
        arrays, [dr.detach(dr.grad(leaf), preserve_type=False) for leaf in leaves], step
    )


def one_after_the_other(arrays: Arrays, rows: list[Float], step: UInt) -> Float:
    """Rows of one width in one array; `step` is that width, in memory."""
    size = dr.width(rows[0])
    block, first = dr.empty(arrays.plain.Float, len(rows) * size), dr.arange(arrays.plain.UInt, size)
    for row in rows:
        dr.scatter(block, row, first, mode=dr.ReduceMode.Permute)
        first = first + step
    return block


_projected = Frozen(projected_splats, by_size=True)
_by_parameters = Frozen(gradients_of_rows, by_size=True)


def wait_for_torch(device: torch.device) -> None:
    """Puts what Dr.Jit does next on a GPU behind what torch does on its current stream; the host goes on.

    Dr.Jit's stream follows the default one by itself, and torch's follows Dr.Jit's when it takes an array.
    """
    if device.type == "cuda":
        torch.cuda.default_stream(device).wait_stream(torch.cuda.current_stream(device))


def visible(arrays: Arrays, gaussians: Gaussians, camera: Camera) -> torch.Tensor:
    """(M,) int64 indices of all Gaussians that are drawn in a camera's frame, and of some beside it."""
    means, log_scales = gaussians.means, gaussians.log_scales
    if not len(gaussians):
        return torch.zeros(0, dtype=torch.int64, device=means.device)
    rows = aligned_rows(arrays, [means, log_scales])
    longest = dr.exp(dr.maximum(dr.maximum(rows[3], rows[4]), rows[5]))
    shown = may_show(rows[:3], longest, camera_numbers(arrays, camera, gaussians.blending), PIXEL_FILTER)
    return arrays.to_torch(arrays.plain.Int(dr.compress(shown)), means.device).long()


# Opacity below which a pixel shows no Gaussian.
_LEAST_OPACITY = 1 / 255
_CHANNELS = 3
# Radiance of a Gaussian without spherical harmonics, and its derivative by the constant one.
_GREY = linear_power(0.5)
_GREY_SLOPE = SH_DC * SRGB_GAMMA / SRGB_SCALE * ((0.5 + SRGB_OFFSET) / SRGB_SCALE) ** (SRGB_GAMMA - 1)


def contributions(
    arrays: Arrays, gaussians: Gaussians, camera: Camera, weights: NDArray[np.float32]
) -> torch.Tensor:
    """(N, C) sums of what N Gaussians contribute to pixels of a view, times weights (H, W, C) of these.

    To a pixel, Gaussian m contributes c_m = alpha_m prod_{n<m} (1 - alpha_n), over the sum of that over all
    Gaussians: the derivative of a rendered pixel by the colour of the Gaussian.
    """
    found = torch.zeros(len(gaussians), weights.shape[2])
    if not len(gaussians):
        return found
    for first in range(0, weights.shape[2], _CHANNELS):
        part = torch.from_numpy(np.ascontiguousarray(weights[..., first : first + _CHANNELS]))
        sh = torch.zeros(1, 3, len(gaussians), requires_grad=True)
        image = render_differentiable(arrays, replace(gaussians, sh=sh, directional=None), camera)
        opacity = image.detach()[..., :1] / _GREY
        share = torch.where(opacity > _LEAST_OPACITY, part / opacity.clamp(min=_LEAST_OPACITY), 0)
        (image[..., : share.shape[-1]] * share).sum().backward()
        assert sh.grad is not None
        found[:, first : first + _CHANNELS] = sh.grad[0, : share.shape[-1]].T / _GREY_SLOPE
    return found
