"""Small filters, against values by hand and other libraries."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import uniform_filter
from torch.nn import functional

from compose.fusion.parents import (
    as_batch,
    box_mean,
    enlarged,
    halved,
    luminance,
    padded_to_even,
    variance_of,
)
from compose.image.colour import luminance as luminance_of_image
from tests import small


def batch(height: int, width: int, channels: int = 3, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(small.rng(seed).uniform(0, 1, (2, channels, height, width)).astype(np.float32))


def test_box_means_repeat_the_borders():
    image = batch(7, 9)
    expected = uniform_filter(image.numpy(), (1, 1, 3, 3), mode="nearest")
    np.testing.assert_allclose(box_mean(image), expected, atol=1e-6)


def test_halving_averages_blocks():
    image = torch.arange(8.0).view(1, 1, 2, 4)
    assert halved(image).tolist() == [[[[2.5, 4.5]]]]
    np.testing.assert_allclose(halved(batch(6, 8)), functional.avg_pool2d(batch(6, 8), 2), atol=1e-7)


def test_halving_an_odd_side_averages_what_is_left():
    image = torch.arange(9.0).view(1, 1, 3, 3)
    assert halved(image).tolist() == [[[[2, 3.5], [6.5, 8]]]]


def test_enlarging_is_bilinear_between_pixel_centres():
    image = torch.tensor([[[[0.0, 4.0]]]])
    assert enlarged(image, torch.zeros(1, 1, 1, 4)).tolist() == [[[[0, 1, 3, 4]]]]


def test_luminance_is_that_of_images():
    image = small.rng().uniform(0, 2, (5, 6, 3)).astype(np.float32)
    found = luminance(as_batch(image))
    assert found.shape == (1, 1, 5, 6)
    np.testing.assert_allclose(found[0, 0], luminance_of_image(image), rtol=1e-6)


def test_variance_from_moments():
    """1 and 3: mean 2, mean square 5, variance 1; rounding must not make it negative."""
    moments = torch.tensor([2.0, 5.0]).view(1, 2, 1, 1)
    assert variance_of(moments).item() == 1
    assert variance_of(torch.tensor([2.0, 3.99]).view(1, 2, 1, 1)).item() == 0


def test_an_image_becomes_a_batch():
    image = small.rng().uniform(0, 1, (4, 5, 3))[:, ::-1]
    found = as_batch(image)
    assert found.shape == (1, 3, 4, 5)
    assert found.dtype == torch.float32
    assert found.is_contiguous()
    np.testing.assert_allclose(found[0, 2], image[..., 2], rtol=1e-6)


def test_a_tensor_becomes_the_same_batch():
    image = small.rng().uniform(0, 1, (4, 5, 3)).astype(np.float32)
    planes = torch.from_numpy(np.moveaxis(image, 2, 0).copy()).permute(1, 2, 0)
    for tensor in (torch.from_numpy(image), planes):
        found = as_batch(tensor)
        assert found.is_contiguous()
        np.testing.assert_array_equal(found, as_batch(image))


@pytest.mark.parametrize(("height", "width"), [(4, 6), (3, 6), (4, 5), (3, 5)])
def test_odd_sides_are_padded_by_their_last_row_and_column(height, width):
    image = batch(height, width)
    padded = padded_to_even(image)
    expected = np.pad(image.numpy(), ((0, 0), (0, 0), (0, height % 2), (0, width % 2)), mode="edge")
    np.testing.assert_array_equal(padded, expected)
