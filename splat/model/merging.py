"""Merges two Gaussians into one with the same moments."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from scipy.special import expit

from splat.model.gaussians import Gaussians
from splat.model.rows import Floats, quaternions_xyzw, rows_of

_MAXIMUM_OPACITY = 0.99
# Least ratio of the shortest axis of a merged Gaussian to its longest.
_FLATTEST = 1e-7


def merge(a: Gaussians, b: Gaussians) -> Gaussians:
    """Merges N pairs of Gaussians.

    The weights are w = o S, with o the opacity and S = s1 s2 + s1 s3 + s2 s3, half the surface of a box with
    the standard deviations as sides. Mean, covariance and colour are means weighted by w; the opacity is
    (w_a + w_b) / S of the result, at most 0.99. It has directional harmonics if one of the two has.

    Args:
        a, b: N Gaussians each, of one degree.

    Returns:
        N Gaussians.
    """
    # Logarithms: weights of tiny or transparent Gaussians would be 0, and their shares 0 / 0.
    weight_a, weight_b = (_log_opacity(g) + _log_surface(rows_of(g.log_scales)) for g in (a, b))
    share = expit(weight_a - weight_b)
    mean_a, mean_b = rows_of(a.means), rows_of(b.means)
    mean = share[:, None] * mean_a + (1 - share)[:, None] * mean_b
    covariance = sum(
        part[:, None, None] * (_covariance(g) + np.einsum("ni,nj->nij", centre - mean, centre - mean))
        for part, g, centre in ((share, a, mean_a), (1 - share, b, mean_b))
    )
    variance, axes = np.linalg.eigh(covariance)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    # Eigenvalues are exact to a share of the largest one only, and rounding can make the others negative.
    log_scales = 0.5 * np.log(np.maximum(variance, _FLATTEST**2 * variance[:, -1:]))
    log_opacity = np.minimum(
        np.logaddexp(weight_a, weight_b) - _log_surface(log_scales), np.log(_MAXIMUM_OPACITY)
    )
    quaternion = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]] if len(axes) else np.zeros((0, 4))
    to_torch = lambda values: torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))  # noqa: E731
    part = to_torch(share)
    merged = Gaussians(
        to_torch(mean.T),
        to_torch(log_scales.T),
        to_torch(quaternion.T),
        to_torch(log_opacity - np.log1p(-np.exp(log_opacity))),
        part * a.all_turning().sh + (1 - part) * b.all_turning().sh,
    )
    apart = a.directional is not None or b.directional is not None
    return merged.turning(_turns(a) | _turns(b)) if apart else merged


def _turns(gaussians: Gaussians) -> torch.Tensor:
    """(N,) which ones have harmonics above the constant one."""
    turns = torch.full((len(gaussians),), gaussians.directional is None)
    return turns if gaussians.directional is None else turns.index_fill(0, gaussians.directional.index, True)


def _log_opacity(gaussians: Gaussians) -> Floats:
    """(N,) logarithm of the opacity."""
    return -np.logaddexp(0, -gaussians.opacity_logits.detach().numpy().astype(np.float64))


def _log_surface(log_sides: Floats) -> Floats:
    """(N,) logarithm of half the surface of boxes, from those of their sides (N, 3)."""
    a, b, c = log_sides.T
    return np.logaddexp(np.logaddexp(a + b, a + c), b + c)


def _covariance(gaussians: Gaussians) -> Floats:
    """(N, 3, 3) covariance in world space."""
    turn = Rotation.from_quat(quaternions_xyzw(gaussians)).as_matrix().reshape(-1, 3, 3)
    scaled = turn * np.exp(rows_of(gaussians.log_scales))[:, None, :]
    return scaled @ scaled.transpose(0, 2, 1)
