"""Errors of the mean and of blocks."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.evaluation.integrator_bench import BLOCK, block_errors, relative_errors


def test_errors_are_those_of_mean_and_blocks():
    truth = np.ones((2 * BLOCK + 5, 3 * BLOCK, 3))
    image = truth.copy()
    image[:BLOCK, BLOCK : 2 * BLOCK] *= 1.5
    image[-5:, :BLOCK] *= 0.25
    found = relative_errors(image, truth)
    area = (0.5 * BLOCK**2 - 0.75 * 5 * BLOCK) / truth[..., 0].size
    assert found["mean"] == pytest.approx(area)
    assert found["worst_block"] == pytest.approx(0.75)
    assert found["p95_block"] < 0.75


def test_black_blocks_have_no_relative_error():
    truth = np.zeros((BLOCK, 2 * BLOCK, 3))
    assert relative_errors(truth, truth) == {"mean": 0.0, "worst_block": 0.0, "p95_block": 0.0}
    truth[:, :BLOCK] = 2
    image = truth.copy()
    image[:, BLOCK:] = 1
    assert relative_errors(image, truth)["worst_block"] == 0


def test_errors_of_blocks_have_signs():
    truth = np.ones((BLOCK, 2 * BLOCK, 3))
    image = truth.copy()
    image[:, :BLOCK] = 0.5
    np.testing.assert_allclose(block_errors(image, truth), [-0.5, 0])
    assert block_errors(image, 0 * truth) == [0]
