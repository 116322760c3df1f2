"""Merged Gaussians have the moments of the pair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.gaussians import SH_DC, Blending, Gaussians
from splat.model.trees import merge
from tests.splat.raster.reference import double, rotation_matrix
from tests.splat.samples import gaussians, spheres


def test_two_spheres_by_hand():
    """Spheres of sd 1 at 0 and of sd 2 at 3, opacities 0.8 and 0.5.

    S = 3 and 12, w = 2.4 and 6, shares 2/7 and 5/7: mean 15/7; variance across 2/7 + 20/7 = 22/7, along it
    (2/7) (1 + (15/7)^2) + (5/7) (4 + (6/7)^2) = 22/7 + 90/49 = 244/49.
    """
    a, b = spheres([0.0], [1.0], 0.8), spheres([3.0], [2.0], 0.5)
    b.sh[:] = 7.0
    parent = merge(a, b)
    assert parent.means[:, 0].tolist() == pytest.approx([15 / 7, 0, 0], abs=1e-6)
    deviation = np.sort(parent.log_scales[:, 0].exp().numpy())
    np.testing.assert_allclose(deviation**2, [22 / 7, 22 / 7, 244 / 49], rtol=1e-5)
    s1, s2, s3 = np.sqrt([22 / 7, 22 / 7, 244 / 49])
    expected = (2.4 + 6) / (s1 * s2 + s1 * s3 + s2 * s3)
    assert torch.sigmoid(parent.opacity_logits)[0].item() == pytest.approx(expected, rel=1e-5)
    # Colours are blended as radiance, of which coefficients give values of the sRGB curve.
    radiance = lambda coefficient: ((0.5 + SH_DC * coefficient + 0.055) / 1.055) ** 2.4  # noqa: E731
    mixed = 2 / 7 * radiance(0) + 5 / 7 * radiance(7)
    assert radiance(parent.sh[0, 0, 0].item()) == pytest.approx(mixed, rel=1e-5)


def test_display_encoded_colours_are_blended_as_such():
    a, b = (replace(g, blending=Blending.DISPLAY) for g in (spheres([0.0], [1.0]), spheres([0.0], [1.0])))
    b.sh[:] = 2.0
    assert merge(a, b).sh[0, 0, 0].item() == pytest.approx(1, rel=1e-5)


def test_the_opacity_is_at_most_99_percent():
    a, b = spheres([0.0], [1.0], 0.9), spheres([0.0], [1.0], 0.9)
    assert torch.sigmoid(merge(a, b).opacity_logits)[0].item() == pytest.approx(0.99, abs=1e-4)


def test_a_gaussian_merged_with_itself_keeps_its_shape():
    g = gaussians(n=10, degree=1)
    parent = merge(g, g)
    torch.testing.assert_close(parent.means, g.means)
    torch.testing.assert_close(parent.sh, g.sh)
    torch.testing.assert_close(covariance(parent), covariance(g), rtol=1e-4, atol=1e-6)


def covariance(g: Gaussians) -> torch.Tensor:
    g = double(g)
    M = rotation_matrix(g.rotations) @ torch.diag_embed(g.log_scales.exp().T)
    return M @ M.transpose(1, 2)


def test_turned_pairs_have_their_covariance():
    """Weighted covariances plus the spread of the means, with dense matrices."""
    rng = np.random.default_rng(3)
    normal = lambda *shape: torch.from_numpy(rng.normal(size=shape).astype(np.float32))  # noqa: E731
    parts = [
        Gaussians(normal(3, 5), normal(3, 5) * 0.3, normal(4, 5), normal(5), normal(4, 3, 5))
        for _ in range(2)
    ]
    weights = []
    for g in parts:
        s = g.log_scales.double().exp()
        weights.append(torch.sigmoid(g.opacity_logits.double()) * (s[0] * s[1] + s[0] * s[2] + s[1] * s[2]))
    shares = [w / sum(weights) for w in weights]
    mean = sum(share * g.means.double() for share, g in zip(shares, parts, strict=True))
    expected = 0
    for share, g in zip(shares, parts, strict=True):
        d = (g.means.double() - mean).T
        expected = expected + share[:, None, None] * (covariance(g) + d[:, :, None] * d[:, None, :])
    torch.testing.assert_close(covariance(merge(*parts)), expected, rtol=1e-4, atol=1e-5)


def test_no_pairs_give_no_gaussians():
    none = gaussians(n=2).select(torch.arange(0))
    assert len(merge(none, none)) == 0
