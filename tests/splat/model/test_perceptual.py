"""The curve has its published values and is smooth where its parts meet."""

from __future__ import annotations

import numpy as np
import torch

from splat.model.gaussians import perceptual_from_radiance
from splat.raster.projection import radiance_from_perceptual


def test_the_curve_and_that_of_the_kernels_are_each_others_inverse(arrays):
    radiance = torch.tensor([0.0, 0.001, 0.2, 1.0, 7.0, 12_000.0])
    back = radiance_from_perceptual(arrays.plain.Float(perceptual_from_radiance(radiance))).torch()
    torch.testing.assert_close(back.cpu(), radiance, rtol=1e-4, atol=1e-7)


def test_the_perceptual_curve_is_that_of_srgb():
    """IEC 61966-2-1: 0.2 is 0.4845, 0.0031308 is 0.04045; a lamp of 50 is 5.3."""
    radiance = torch.tensor([0.0, 0.001, 0.0031308, 0.2, 1.0, 50.0])
    expected = [0, 0.01292, 0.04045, 0.4845, 1, 5.33]
    np.testing.assert_allclose(perceptual_from_radiance(radiance), expected, atol=5e-3, rtol=1e-4)


def test_gradients_are_finite_everywhere():
    radiance = torch.tensor([0.0, 0.0031308, 1.0, 1e4], requires_grad=True)
    perceptual_from_radiance(radiance).sum().backward()
    assert torch.isfinite(radiance.grad).all()
    assert (radiance.grad > 0).all()
