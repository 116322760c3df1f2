"""Blends projected splats of any number of channels for torch, with the gradient.

The kernels blend three channels at a time. Lists of splats are made once for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import torch
from torch.autograd.function import once_differentiable

from compose.base.arrays import Arrays
from compose.base.frozen import AnySize, Frozen, capacity
from splat.raster.binning import Boxed, Candidates, TileBounds, boxed, everywhere, packed
from splat.raster.blending import Compositing, gradients_from_sums
from splat.raster.blocks import CHANNELS
from splat.raster.differentiable import PaddedRows, aligned_rows, wait_for_torch
from splat.raster.parts import Parts, rasterize_parts, sums_of_parts
from splat.raster.projection import Splats
from splat.raster.records import Records
from splat.raster.tiles import TileGrid

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
    def forward(  # type: ignore[override]
        ctx: Any,
        arrays: Arrays,
        grid: TileGrid,
        rules: Compositing,
        absolute: torch.Tensor | None,
        *tensors: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        of = FlatSplats(*tensors)
        ordered = [of.centres.T, *tensors[1:5], of.depth, of.channels.T]
        rows = aligned_rows(arrays, ordered)
        device = of.depth.device
        wait_for_torch(device)
        count = len(of.depth)
        padded = PaddedRows(AnySize(rows), arrays.constant(count), capacity(count + 1))
        splats, found, colours = _listed(arrays, padded, everywhere(arrays, grid), grid.side)
        order = _exact_depth_order(arrays, splats.depth, found.count > 0)
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
        ctx: Any, by_image: torch.Tensor | None, by_opacity: torch.Tensor | None
    ) -> tuple[torch.Tensor | None, ...]:
        if ctx.state is None:
            raise RuntimeError("this image was differentiated already: render it again")
        return (None, None, None, None, *_gradients(ctx, by_image, by_opacity))


def _gradients(
    ctx: Any, by_image: torch.Tensor | None, by_opacity: torch.Tensor | None
) -> list[torch.Tensor | None]:
    """Gradients by the tensors of `FlatSplats`, in their order."""
    arrays, splats, parts, colours, images, absolute = ctx.state
    count, channels = ctx.saved_tensors[_SHAPE - 1].shape
    ctx.state = None
    given = [gradient for gradient in (by_image, by_opacity) if gradient is not None]
    if not given:
        return [None] * len(ctx.saved_tensors)
    # On a card, torch calls this in a thread of its own, which may only use arrays of an earlier scope.
    dr.detail.new_scope(dr.backend_v(arrays.plain.Float))
    device, shape, further = given[0].device, None, []
    for k, (colour, image) in enumerate(zip(colours, images, strict=True)):
        own = None if by_image is None else by_image[..., AT_ONCE * k : AT_ONCE * (k + 1)]
        opaque = None if k else by_opacity
        rules = replace(parts.rules, by_opacity=opaque is not None, absolute=absolute is not None)
        flow = dr.detach(arrays.from_torch(_flow(parts.grid, own, opaque, device)), preserve_type=False)
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
    arrays: Arrays, splats: Splats, shape: list[Any], channels: list[Any], step: Any
) -> Any:
    """Gradients by the numbers and channels of splats, one after the other in one array.

    From the sums of `sums_of_parts`, the first six added up over all channels; `step` is the number of
    splats, in memory.
    """
    found = gradients_from_sums(splats, [*shape, *channels])
    size = dr.width(splats.x)
    block, first = dr.empty(arrays.plain.Float, len(found) * size), dr.arange(arrays.plain.UInt, size)
    for by_row in found:
        dr.scatter(block, by_row, first, mode=dr.ReduceMode.Permute)
        first = first + step
    return block


def _exact_depth_order(arrays: Arrays, depth: Any, seen: Any) -> Any:
    """Indices of splats from near to far, by all bits of their positive depths; those not seen come last."""
    bits = dr.reinterpret_array(arrays.plain.UInt, depth)
    return arrays.argsort(dr.select(seen, bits, _BEHIND_ALL), 1 << 31)


_listed = Frozen(listed_channels, by_size=True)
_by_splats = Frozen(gradients_of_channels, by_size=True)
