"""Parameters of Gaussians as rows of float64."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from splat.model.forest import Layer
from splat.model.gaussians import Gaussians

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def rows_of(tensor: torch.Tensor) -> Floats:
    return tensor.detach().numpy().T.astype(np.float64)


def means_of(layer: Layer) -> Floats:
    return rows_of(layer.gaussians.means)


def quaternions_xyzw(gaussians: Gaussians) -> Floats:
    return rows_of(gaussians.rotations)[:, [1, 2, 3, 0]]
