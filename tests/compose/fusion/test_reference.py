"""Errors against noisy references."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from compose.fusion.features import perceived, perceived_slope
from compose.fusion.fitting import FusionReference
from tests import small

SIZE = 96


def noisy(truth: np.ndarray, seed: int, spread: float) -> np.ndarray:
    return (truth + spread * small.rng(seed).normal(size=truth.shape)).astype(np.float32)


@pytest.mark.parametrize("spread", [0.02, 0.1])
def test_squared_errors_are_those_against_the_truth_whatever_the_noise(spread):
    """Within four standard errors, where the mean square of the targets alone is far off."""
    truth = small.rng(0).uniform(0.2, 0.9, (SIZE, SIZE, 3)).astype(np.float32)
    reference = FusionReference(truth, (noisy(truth, 1, spread), noisy(truth, 2, spread)))
    estimate = torch.from_numpy(truth * 1.1).permute(2, 0, 1)
    target, noise = reference.targets()
    expected = (perceived(estimate) - perceived(torch.from_numpy(truth).permute(2, 0, 1))) ** 2
    with_noise = (perceived(estimate) - target) ** 2
    without = with_noise - noise**2
    standard_error = float(without.std()) / np.sqrt(without.numel())
    assert float(without.mean()) == pytest.approx(float(expected.mean()), abs=4 * standard_error)
    assert float(with_noise.mean() - expected.mean()) > 4 * standard_error


def test_a_single_bright_path_is_spread_over_its_neighbourhood():
    """Nothing of its light is lost, and nothing reaches further than half a window."""
    truth = np.full((101, 101, 3), 0.5, dtype=np.float32)
    bright = truth.copy()
    bright[50, 50] = 1000
    target, _ = FusionReference(truth, (bright, truth)).targets()
    change = target - perceived(torch.tensor(0.5))
    expected = float(perceived_slope(torch.tensor(0.5))) * 999.5 / 2
    assert float(change[0].sum()) == pytest.approx(expected, rel=1e-3)
    assert float(change.max()) < 1
    rows, columns = torch.nonzero(change[0].abs() > 1e-5, as_tuple=True)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (34, 66, 34, 66)


def test_noise_free_halves_leave_no_noise():
    truth = small.rng(0).uniform(0, 5, (8, 6, 3)).astype(np.float32)
    target, noise = FusionReference(truth, (truth, truth)).targets()
    assert target.shape == noise.shape == (3, 8, 6)
    assert torch.equal(noise, torch.zeros(3, 8, 6))
    torch.testing.assert_close(target, perceived(torch.from_numpy(truth).permute(2, 0, 1)))


def test_the_slope_of_perceived_radiance_is_its_derivative():
    radiance = torch.tensor([0.0, 0.01, 0.5, 0.99, 1.01, 7.0, 1e3], dtype=torch.float64)
    step = 1e-6
    difference = (perceived(radiance + step) - perceived((radiance - step).clamp(min=0))) / torch.tensor(
        [step, *[2 * step] * 6], dtype=torch.float64
    )
    torch.testing.assert_close(perceived_slope(radiance), difference, rtol=1e-3, atol=1e-9)
