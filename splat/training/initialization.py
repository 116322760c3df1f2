"""Places Gaussians on the surfaces that training frames show."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from splat.model.gaussians import SH_DC, Gaussians, concatenated, sh_count
from splat.model.perceptual import perceptual_from_radiance
from splat.training.views import TrainingView

# A seed is a flat disc on its surface, this much thinner than wide.
_FLATNESS = 0.2
_INITIAL_OPACITY = 0.5


def seed_from_views(
    views: list[TrainingView], count: int, degree: int, rng: np.random.Generator
) -> Gaussians:
    """Seeds at `count` random pixels of all views, wide enough to cover the surfaces together.

    Pixels where nothing was hit give no seed.
    """
    pixels = views[0].camera.width * views[0].camera.height
    # The views overlap, so that about `count` seeds cover what one of them sees.
    spacing = np.sqrt(pixels / count)
    shares = np.full(len(views), count // len(views))
    shares[: count % len(views)] += 1
    parts = []
    for view, share in zip(views, shares, strict=True):
        size = view.distance.size
        parts.append(
            seed_at(view, rng.choice(size, min(int(share), size), replace=False), spacing * 0.6, degree)
        )
    return concatenated(parts)


def seed_at(view: TrainingView, pixels: NDArray[np.int64], size: float, degree: int) -> Gaussians:
    """Seeds at pixels of one view.

    Args:
        view: the frame.
        pixels: (M,) row-major indices; pixels where nothing was hit give no seed.
        size: standard deviation in pixels of that frame.
        degree: of the spherical harmonics, of which only the constant one is set.

    Returns:
        At most M Gaussians.
    """
    camera = view.camera
    distance = view.distance.ravel()[pixels]
    pixels, distance = pixels[np.isfinite(distance)], distance[np.isfinite(distance)]
    centres = np.stack([pixels % camera.width + 0.5, pixels // camera.width + 0.5], axis=1)
    rays = camera.rays(centres)
    means = camera.position + rays * distance[:, None]
    deviation = np.maximum(size * distance / camera.fy, 1e-7)
    scales = np.stack([deviation, deviation, deviation * _FLATNESS])
    radiance = torch.from_numpy(view.radiance.reshape(-1, 3)[pixels].T.copy())
    n = len(pixels)
    sh = torch.zeros(sh_count(degree), 3, n)
    sh[0] = (perceptual_from_radiance(radiance.clamp(min=0)) - 0.5) / SH_DC
    normals = view.normal.reshape(-1, 3)[pixels]
    return Gaussians(
        torch.from_numpy(means.T.astype(np.float32).copy()),
        torch.from_numpy(np.log(scales).astype(np.float32)),
        torch.from_numpy(_rotation_to(normals).T.astype(np.float32).copy()),
        torch.full((n,), float(np.log(_INITIAL_OPACITY / (1 - _INITIAL_OPACITY)))),
        sh,
    )


def _rotation_to(normals: NDArray[np.float32]) -> NDArray[np.float64]:
    """Quaternions (M, 4) that turn the z axis into the normals (M, 3); identity for a zero normal."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.where(length > 1e-6, normals / np.maximum(length, 1e-6), [0.0, 0.0, 1.0])
    # Half-way quaternion (1 + z.n, z x n); for n = -z any half turn about a horizontal axis works.
    quaternion = np.stack([1 + unit[:, 2], -unit[:, 1], unit[:, 0], np.zeros(len(unit))], axis=1)
    quaternion[unit[:, 2] < -1 + 1e-6] = [0.0, 1.0, 0.0, 0.0]
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
