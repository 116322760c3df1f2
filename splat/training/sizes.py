"""How large Gaussians may become: small beside their distance from whoever looks at them.

The rasterizer projects a Gaussian linearly around its centre. A large one that is flat on a wall close beside
a viewer spills over all of the view, as a haze that its ellipsoid does not have.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from splat.raster.projection import NEAR
from splat.training.views import TrainingView

# Longest axis, as a standard deviation, over the distance from the nearest training view.
_LARGEST = 0.12


def largest_log_scales(means: torch.Tensor, views: list[TrainingView]) -> torch.Tensor:
    """(N,) largest logarithm that the scales of Gaussians may have.

    Args:
        means: (3, N) centres.
        views: in the same coordinates. What is nearer to one than the near plane is not drawn anyway.
    """
    eyes = cKDTree(np.stack([view.camera.position for view in views]))
    distance, _ = eyes.query(means.detach().T.double().numpy(), workers=-1)
    return torch.from_numpy(np.log(_LARGEST * np.maximum(distance, NEAR))).float()
