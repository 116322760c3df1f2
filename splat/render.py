"""Gaussians to image: projection, binning and rasterization in one call, for rendering and for torch."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import torch

from compose.view import Camera
from splat.arrays import Arrays
from splat.binning import Bins, bin_splats
from splat.gaussians import Gaussians
from splat.project import PIXEL_FILTER, Parameters, project
from splat.raster import padded_size, rasterize, rasterize_backward


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


def low_pass_for(camera: Camera, trained_focal: float) -> float:
    """Variance in px^2 of the filter on a camera, for Gaussians trained at a focal length in pixels.

    On a finer film than that of the training frames nothing constrains detail between their pixels;
    the filter keeps its angle there, so that the picture is the trained one, enlarged.
    """
    return PIXEL_FILTER * max(1.0, camera.fy / trained_focal) ** 2


class SplatRenderer:
    """Renders one set of Gaussians that stays on the device.

    Args:
        arrays: the backend's array types.
        gaussians: what to draw.
        trained_focal: vertical focal length in pixels of the frames that they were trained on.
    """

    def __init__(self, arrays: Arrays, gaussians: Gaussians, trained_focal: float):
        self.arrays = arrays
        self.trained_focal = trained_focal
        self._gaussians = gaussians  # keeps the memory alive that the arrays alias
        self._parameters = parameters_from(arrays, gaussians)

    def render(self, camera: Camera, wanted: np.ndarray | None = None) -> tuple[Any, Bins]:
        """Linear radiance as a flat buffer of whole tiles, and the bins that say how to read it.

        Args:
            camera: the view.
            wanted: (rows, columns) bool, tiles to draw; all by default.
        """
        low_pass = low_pass_for(camera, self.trained_focal)
        splats = project(self.arrays, self._parameters, camera, low_pass).detached()
        dr.eval(splats.__dict__)
        bins = bin_splats(self.arrays, splats, camera.width, camera.height, wanted)
        return rasterize(self.arrays, splats, bins), bins


class _Render(torch.autograd.Function):
    """The bridge: torch holds parameters and the loss, Dr.Jit computes image and gradients."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any, arrays: Arrays, camera: Camera, low_pass: float, *tensors: torch.Tensor
    ) -> torch.Tensor:
        parameters = parameters_from(arrays, Gaussians(*tensors))
        leaves = parameters.leaves()
        dr.enable_grad(leaves)
        projected = project(arrays, parameters, camera, low_pass)
        splats = projected.detached()
        dr.eval(splats.__dict__, projected.differentiable())
        bins = bin_splats(arrays, splats, camera.width, camera.height)
        image = rasterize(arrays, splats, bins)
        ctx.state = (arrays, leaves, projected, splats, bins, image, [t.shape for t in tensors])
        width, height = padded_size(bins)
        buffer = arrays.to_torch(image, tensors[0].device).reshape(height, width, 3)
        # A copy: the backward pass still needs the buffer as it is.
        return buffer[: camera.height, : camera.width].clone()

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[Any, ...]:  # type: ignore[override]
        arrays, leaves, projected, splats, bins, image, shapes = ctx.state
        width, height = padded_size(bins)
        padded = torch.zeros(height, width, 3, device=gradient.device)
        padded[: bins.height, : bins.width] = gradient
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
