"""Which Gaussians a view may show; the others cost nothing where they are left out."""

from __future__ import annotations

import drjit as dr
import torch

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from splat.model.gaussians import Gaussians
from splat.raster.differentiable import aligned_rows
from splat.raster.projection import PIXEL_FILTER, may_show


def visible(arrays: Arrays, gaussians: Gaussians, camera: Camera) -> torch.Tensor:
    """(M,) int64 indices of all Gaussians that are drawn in a camera's frame, and of some beside it.

    Args:
        arrays: the backend's array types.
        gaussians: N Gaussians.
        camera: the view, in the same coordinates.
    """
    means, log_scales = gaussians.means, gaussians.log_scales
    if not len(gaussians):
        return torch.zeros(0, dtype=torch.int64, device=means.device)
    rows = [dr.detach(row, preserve_type=False) for row in aligned_rows(arrays, [means, log_scales])]
    longest = dr.exp(dr.maximum(dr.maximum(rows[3], rows[4]), rows[5]))
    index = arrays.plain.Int(dr.compress(may_show(arrays, rows[:3], longest, camera, PIXEL_FILTER)))
    return arrays.to_torch(index, means.device).long()
