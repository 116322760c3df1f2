"""Contributions (Eq. 1) against their float64 twin."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splat.model.gaussians import Gaussians
from splat.raster.differentiable import contributions
from splat.raster.projection import PIXEL_FILTER
from tests.splat.raster import reference
from tests.splat.samples import KINDS, camera, gaussians


def twin(g: Gaussians, cam, weights: np.ndarray) -> torch.Tensor:
    """(N, C) float64: every pixel against every Gaussian, as Eq. 1 reads."""
    splats = reference.project(reference.double(g), cam, PIXEL_FILTER)
    x, y = np.meshgrid(np.arange(cam.width) + 0.5, np.arange(cam.height) + 0.5)
    pixels = torch.tensor(np.stack([x, y]))
    transmittance = torch.ones(cam.height, cam.width, dtype=torch.float64)
    blended = torch.zeros(len(g), cam.height, cam.width, dtype=torch.float64)
    for m in torch.argsort(splats["depth"]).tolist():
        d, Q = pixels - splats["centre"][:, m, None, None], splats["inverse"][m]
        q = Q[0, 0] * d[0] ** 2 + 2 * Q[0, 1] * d[0] * d[1] + Q[1, 1] * d[1] ** 2
        alpha = torch.clamp(splats["opacity"][m] * torch.exp(-q / 2), max=0.99)
        alpha = torch.where(alpha >= 1 / 255, alpha, 0)
        blended[m] = transmittance * alpha
        transmittance = transmittance * (1 - alpha)
    total = blended.sum(dim=0)
    share = torch.where(total > 1 / 255, blended / total, 0)
    return torch.einsum("nhw,hwc->nc", share, torch.from_numpy(weights).double())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("channels", [1, 5])
def test_contributions_equal_the_twin(arrays, kind, channels):
    g, cam = gaussians(kind), camera()
    weights = np.random.default_rng(0).random((cam.height, cam.width, channels), dtype=np.float32)
    found = contributions(arrays, g, cam, weights).double()
    expected = twin(g, cam, weights)
    assert found.shape == (len(g), channels)
    assert expected.max() > 1
    # Where a block stops at a transmittance of 1e-4, and at the steps of 1/255.
    torch.testing.assert_close(found, expected, atol=2e-3 * float(expected.max()), rtol=1e-3)


def test_contributions_to_a_pixel_sum_to_one(arrays):
    """Every pixel that shows something is divided among those that it shows."""
    g, cam = gaussians("overlap"), camera()
    weights = np.ones((cam.height, cam.width, 1), dtype=np.float32)
    total = float(contributions(arrays, g, cam, weights).sum())
    image = reference.render(reference.double(g), cam, PIXEL_FILTER)
    assert total == pytest.approx(float((image.sum(dim=-1) > 0).sum()), rel=0.05)


def test_of_no_gaussians_there_are_none(arrays):
    weights = np.ones((camera().height, camera().width, 2), dtype=np.float32)
    assert contributions(arrays, Gaussians.none(0), camera(), weights).shape == (0, 2)
