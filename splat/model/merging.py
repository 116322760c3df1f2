"""Merges two Gaussians into one with the same moments."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from splat.model.gaussians import Gaussians
from splat.model.rows import Floats, quaternions_xyzw, rows_of

_MAXIMUM_OPACITY = 0.99


def merge(a: Gaussians, b: Gaussians) -> Gaussians:
    """Merges N pairs of Gaussians.

    The weights are w = o S, with o the opacity and S = s1 s2 + s1 s3 + s2 s3, half the surface of a box with
    the standard deviations as sides. Mean, covariance and colour are means weighted by w; the opacity is
    (w_a + w_b) / S of the result, at most 0.99.

    Args:
        a, b: N Gaussians each, of one degree.

    Returns:
        N Gaussians.
    """
    weight_a, weight_b = (_opacity(g) * _surface(np.exp(rows_of(g.log_scales))) for g in (a, b))
    share = weight_a / (weight_a + weight_b)
    mean_a, mean_b = rows_of(a.means), rows_of(b.means)
    mean = share[:, None] * mean_a + (1 - share)[:, None] * mean_b
    covariance = sum(
        part[:, None, None] * (_covariance(g) + np.einsum("ni,nj->nij", centre - mean, centre - mean))
        for part, g, centre in ((share, a, mean_a), (1 - share, b, mean_b))
    )
    variance, axes = np.linalg.eigh(covariance)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    deviation = np.sqrt(np.maximum(variance, 1e-20))
    opacity = np.minimum((weight_a + weight_b) / _surface(deviation), _MAXIMUM_OPACITY)
    quaternion = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]] if len(axes) else np.zeros((0, 4))
    to_torch = lambda values: torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))  # noqa: E731
    part = to_torch(share)
    return Gaussians(
        to_torch(mean.T),
        to_torch(np.log(deviation).T),
        to_torch(quaternion.T),
        to_torch(np.log(opacity / (1 - opacity))),
        part * a.sh + (1 - part) * b.sh,
    )


def _opacity(gaussians: Gaussians) -> Floats:
    """(N,) opacity in 0..1."""
    return 1 / (1 + np.exp(-gaussians.opacity_logits.detach().numpy().astype(np.float64)))


def _surface(deviation: Floats) -> Floats:
    """(N,) half the surface of boxes with sides (N, 3)."""
    a, b, c = deviation.T
    return a * b + a * c + b * c


def _covariance(gaussians: Gaussians) -> Floats:
    """(N, 3, 3) covariance in world space."""
    turn = Rotation.from_quat(quaternions_xyzw(gaussians)).as_matrix().reshape(-1, 3, 3)
    scaled = turn * np.exp(rows_of(gaussians.log_scales))[:, None, :]
    return scaled @ scaled.transpose(0, 2, 1)
