"""The window moves along either axis, and its transpose is one."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
import torch

from splat.training.loss import WEIGHTS, Axis, blur
from tests.splat.training import reference

HEIGHT, WIDTH = 29, 22


def moved(arrays, image: np.ndarray, axis) -> np.ndarray:
    """An image (H, W, 3) after the window has moved along an axis."""
    Float = arrays.plain.Float
    flat = Float(image.astype(np.float32).ravel())
    load = lambda index, inside: [dr.gather(Float, flat, index, inside)]  # noqa: E731
    result = blur(arrays, axis, axis.sizes(arrays), load)[0].numpy()
    return result.reshape(axis.lines, -1, 3) if axis.is_horizontal else result.reshape(-1, axis.lines, 3)


def test_the_window_sums_to_one_and_is_symmetric():
    assert sum(WEIGHTS) == pytest.approx(1)
    assert WEIGHTS[::-1] == WEIGHTS


def test_both_axes_together_equal_the_twin(arrays):
    image = np.random.default_rng(0).uniform(size=(HEIGHT, WIDTH, 3))
    across, down = Axis.over(HEIGHT, WIDTH, True), Axis.over(WIDTH - 10, HEIGHT, False)
    found = moved(arrays, moved(arrays, image, across), down)
    expected = reference.blurred(torch.from_numpy(image).permute(2, 0, 1)).permute(1, 2, 0)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("axis", [Axis.over(HEIGHT, WIDTH, True), Axis.over(WIDTH, HEIGHT, False)])
def test_the_transpose_is_one(arrays, axis):
    """<window x, y> = <x, transpose y> for any x and y."""
    rng = np.random.default_rng(1)
    x = rng.normal(size=(HEIGHT, WIDTH, 3))
    there = moved(arrays, x, axis)
    y = rng.normal(size=there.shape)
    back = moved(arrays, y, axis.transposed())
    assert back.shape == x.shape
    assert (there * y).sum() == pytest.approx((x * back).sum(), rel=1e-4)
