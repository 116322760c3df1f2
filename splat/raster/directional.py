"""Radiance that turns with the view, of those Gaussians that have such: computed for them alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from splat.model.gaussians import SH_DC, Directional, Gaussians
from splat.raster.harmonics import sh_basis
from splat.raster.projection import NEAR


def seen_from(gaussians: Gaussians, eye: NDArray[np.float64]) -> Gaussians:
    """Gaussians whose constant harmonic is what they show to an eye (3,), for kernels; differentiable.

    Only those with directional harmonics change. Where all have them, kernels compute them, from `sh`.
    """
    further = gaussians.directional
    if further is None or len(further) == len(gaussians):
        return gaussians.all_turning()
    radiance = directional_radiance(further, gaussians.means, eye)
    constant = gaussians.sh[0].index_add(1, further.index, radiance / SH_DC)
    return replace(gaussians, sh=constant[None], directional=None)


def directional_radiance(further: Directional, means: torch.Tensor, eye: NDArray[np.float64]) -> torch.Tensor:
    """(3, M) what harmonics above the constant one add to the perceptual radiance that an eye sees.

    Args:
        further: of M of N Gaussians.
        means: (3, N) their centres.
        eye: (3,) in the same coordinates.
    """
    # In float64, as in the projection: in float32 a difference of large numbers is lost.
    position = torch.from_numpy(np.ascontiguousarray(eye)).to(means.device)[:, None]
    from_eye = means.index_select(1, further.index).double() - position
    # What is nearer is not drawn; a Gaussian at the eye itself has no direction.
    direction = (from_eye / from_eye.norm(dim=0).clamp(min=NEAR)).to(means.dtype)
    basis = sh_basis(further.sh.shape[0] + 1, list(direction))[1:]
    if not basis:
        return means.new_zeros(3, len(further))
    return (further.sh * torch.stack(basis)[:, None]).sum(dim=0)
