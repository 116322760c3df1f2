"""Gaussians to image for torch: projection, binning and rasterization in one call, with the gradient."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import torch

from compose.camera.camera import Camera
from splat.base.arrays import Arrays
from splat.model.gaussians import Gaussians
from splat.raster.binning import bin_splats
from splat.raster.blending import padded_size, rasterize
from splat.raster.blocks import CHANNELS
from splat.raster.gradient import rasterize_backward
from splat.raster.projection import PIXEL_FILTER, Parameters, project


def parameters_from(arrays: Arrays, gaussians: Gaussians) -> Parameters:
    """The Gaussians' rows as Dr.Jit floats; on the CPU they share the tensors' memory."""
    rows = lambda tensor: [arrays.from_torch(row) for row in tensor]  # noqa: E731
    return Parameters(
        rows(gaussians.means),
        rows(gaussians.log_scales),
        rows(gaussians.rotations),
        arrays.from_torch(gaussians.opacity_logits),
        [rows(coefficient) for coefficient in gaussians.sh],
    )


class _Render(torch.autograd.Function):
    """The bridge: torch holds parameters and the loss, Dr.Jit computes image and gradients."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any, arrays: Arrays, camera: Camera, low_pass: float, *tensors: torch.Tensor
    ) -> torch.Tensor:
        parameters = parameters_from(arrays, Gaussians(*tensors))
        leaves = parameters.leaves()
        dr.enable_grad(leaves)
        projected = project(parameters, camera, low_pass)
        splats = projected.detached()
        dr.eval(splats.__dict__, projected.differentiable())
        bins = bin_splats(arrays, splats, camera.width, camera.height)
        image = rasterize(arrays, splats, bins)
        ctx.state = (arrays, leaves, projected, splats, bins, image, [t.shape for t in tensors])
        width, height = padded_size(bins)
        buffer = arrays.to_torch(image, tensors[0].device).reshape(height, width, CHANNELS)
        # A copy: the backward pass still needs the buffer as it is.
        return buffer[: camera.height, : camera.width, :3].clone()

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[Any, ...]:  # type: ignore[override]
        arrays, leaves, projected, splats, bins, image, shapes = ctx.state
        width, height = padded_size(bins)
        padded = torch.zeros(height, width, CHANNELS, device=gradient.device)
        padded[: bins.height, : bins.width, :3] = gradient
        flow = dr.detach(arrays.from_torch(padded), preserve_type=False)
        gradients = rasterize_backward(arrays, splats, bins, image, flow)
        for value, by_value in zip(projected.differentiable(), gradients, strict=True):
            dr.accum_grad(value, by_value)
        dr.enqueue(dr.ADMode.Backward, projected.differentiable())
        dr.traverse(dr.ADMode.Backward)
        by_leaf = [dr.grad(leaf) for leaf in leaves]
        dr.eval(by_leaf)
        rows = [arrays.to_torch(g, gradient.device) for g in by_leaf]
        results, first = [], 0
        for shape in shapes:
            count = int(np.prod(shape[:-1]))
            results.append(torch.stack(rows[first : first + count]).reshape(shape))
            first += count
        return (None, None, None, *results)


def render_differentiable(
    arrays: Arrays, gaussians: Gaussians, camera: Camera, low_pass: float = PIXEL_FILTER
) -> torch.Tensor:
    """(H, W, 3) linear radiance that torch can differentiate with respect to the Gaussians' tensors."""
    return _Render.apply(arrays, camera, low_pass, *(tensor for _, tensor in gaussians.tensors()))
