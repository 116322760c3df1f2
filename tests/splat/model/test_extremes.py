"""Trees over Gaussians at the ends of size and opacity."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splat.model.gaussians import SH_DC, Gaussians
from splat.model.trees import merge
from tests.extremes import extreme


def one(size: float, logit: float, sh: float) -> Gaussians:
    """A round Gaussian at the origin."""
    return Gaussians(
        torch.zeros(3, 1),
        torch.full((3, 1), size),
        torch.tensor([[1.0], [0.0], [0.0], [0.0]]),
        torch.full((1,), logit),
        torch.full((1, 3, 1), sh),
    )


@pytest.mark.parametrize(
    ("size", "logit"),
    [
        pytest.param(
            s, o, marks=extreme(f"parent of {n}", given=g, expected="the mean colour, size and opacity")
        )
        for s, o, n, g in [
            (-4.0, -800.0, "transparent Gaussians", "opacity logits of -800"),
            (-60.0, 0.0, "tiny Gaussians", "deviations of e^-60"),
            (80.0, 0.0, "huge Gaussians", "deviations of e^80"),
            (-200.0, -500.0, "Gaussians of no weight", "deviations of e^-200, logits of -500"),
        ]
    ],
)
def test_parents_of_extreme_children_are_finite(size, logit, got):
    """Two equal Gaussians: the parent is as large, and has twice the opacity, at most 0.99."""
    parent = merge(one(size, logit, 1.0), one(size, logit, 3.0))
    assert parent.is_finite()
    # Half of the radiance of each, by the sRGB curve.
    radiance = lambda coefficient: ((0.5 + SH_DC * coefficient + 0.055) / 1.055) ** 2.4  # noqa: E731
    mixed = 0.5 * (radiance(1) + radiance(3))
    assert radiance(parent.sh[0, 0, 0].item()) == pytest.approx(mixed, rel=1e-5)
    np.testing.assert_allclose(parent.log_scales.numpy(), size, rtol=1e-5)
    expected = logit + np.log(2) if logit < -100 else np.log(0.99 / 0.01)
    assert got(parent.opacity_logits.item(), ".2f") == pytest.approx(expected, rel=1e-4)
