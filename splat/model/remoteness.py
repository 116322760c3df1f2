"""How much farther away Gaussians are than most: there, a pixel is as many times as large."""

from __future__ import annotations

import torch

from compose.camera.place import TYPICAL_DISTANCE

# In units of a place. What is nearer counts as typical, since views differ in how far away it is from them.
_FAR = 32 * TYPICAL_DISTANCE


def remoteness(means: torch.Tensor) -> torch.Tensor:
    """(N,) distance of far Gaussians from the origin of their place over the typical distance; 1 for others.

    Args:
        means: (3, N) centres in the coordinates of a place.
    """
    distance = torch.linalg.vector_norm(means.detach(), dim=0)
    return torch.where(distance > _FAR, distance / TYPICAL_DISTANCE, 1.0)
