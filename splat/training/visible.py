"""Which Gaussians a view may show; the others cost nothing where they are left out."""

from __future__ import annotations

import math

import drjit as dr
import torch

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from splat.model.gaussians import Gaussians
from splat.raster.binning import MINIMUM_ALPHA
from splat.raster.differentiable import aligned_rows
from splat.raster.projection import PIXEL_FILTER, view_position

# Standard deviations from the centre at which an opaque Gaussian's alpha falls below what is drawn.
_REACH = math.sqrt(-2 * math.log(MINIMUM_ALPHA))


def visible(arrays: Arrays, gaussians: Gaussians, camera: Camera) -> torch.Tensor:
    """(M,) int64 indices of all Gaussians that are drawn in a camera's frame, and of some beside it.

    Args:
        arrays: the backend's array types.
        gaussians: N Gaussians.
        camera: the view, in the same coordinates.
    """
    means, log_scales = gaussians.means, gaussians.log_scales
    if not len(gaussians):
        return torch.zeros(0, dtype=torch.int64)
    rows = [dr.detach(row, preserve_type=False) for row in aligned_rows(arrays, [means, log_scales])]
    seen, x, y, spread = view_position(arrays, rows[:3], camera)
    longest = spread * dr.exp(dr.maximum(dr.maximum(rows[3], rows[4]), rows[5]))
    # The width of what is filtered is less than this sum.
    reach = _REACH * (longest + math.sqrt(PIXEL_FILTER))
    width, height = (dr.opaque(arrays.plain.Float, float(side)) for side in (camera.width, camera.height))
    within = seen & (x + reach > 0) & (x - reach < width) & (y + reach > 0) & (y - reach < height)
    index = arrays.plain.Int(dr.compress(within))
    return arrays.to_torch(index, means.device).long()
