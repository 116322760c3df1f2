"""Rows of float64 from columns of float32."""

from __future__ import annotations

import numpy as np
import torch

from splat.model.points import quaternions_xyzw, rows_of
from tests.splat.samples import gaussians


def test_rows_are_one_per_gaussian():
    rows = rows_of(torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], requires_grad=True))
    assert rows.dtype == np.float64
    assert rows.tolist() == [[1, 4], [2, 5], [3, 6]]


def test_means_are_points():
    g = gaussians(n=4)
    assert rows_of(g.means).shape == (4, 3)
    np.testing.assert_array_equal(rows_of(g.means)[2], g.means[:, 2].numpy())


def test_quaternions_are_in_scipys_order():
    g = gaussians(n=2)
    g.rotations[:, 1] = torch.tensor([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(quaternions_xyzw(g)[1], [0.2, 0.3, 0.4, 0.1], rtol=1e-6)
