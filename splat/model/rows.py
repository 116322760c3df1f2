"""Parameters of Gaussians in float64, one row per Gaussian."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from splat.model.gaussians import Gaussians

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def rows_of(tensor: torch.Tensor) -> Floats:
    """(N, K) float64 rows of a tensor (K, N)."""
    return tensor.detach().numpy().T.astype(np.float64)


def means_of(gaussians: Gaussians) -> Floats:
    """(N, 3) centres in world space."""
    return rows_of(gaussians.means)


def quaternions_xyzw(gaussians: Gaussians) -> Floats:
    """(N, 4) rotations in SciPy's order x, y, z, w, not necessarily of unit length."""
    return rows_of(gaussians.rotations)[:, [1, 2, 3, 0]]
