"""The network and the mixture that its outputs stand for."""

from __future__ import annotations

import os

import numpy as np
import pytest
import torch

from compose.fusion.features import Features
from compose.fusion.network import OUTPUTS, Fusion, mixture
from tests.compose.fusion.examples import random_fusion


def features(height: int = 8, width: int = 12) -> Features:
    generator = torch.Generator().manual_seed(0)
    draw = lambda channels, h, w: torch.rand(1, channels, h, w, generator=generator)  # noqa: E731
    return Features(draw(10, height, width), draw(22, height // 2, width // 2), [draw(3, height, width)] * 3)


def test_networks_in_files_depend_on_names_and_shapes():
    shapes = {name: tuple(tensor.shape) for name, tensor in Fusion().state_dict().items()}
    assert shapes == {
        "reduce.weight": (24, 10, 2, 2),
        "reduce.bias": (24,),
        "relate.weight": (24, 46, 3, 3),
        "relate.bias": (24,),
        "judge.weight": (36, 24, 3, 3),
        "judge.bias": (36,),
        "shares": (2, 5, 4, 3),
        "gains": (2, 5, 4),
    }
    assert list(OUTPUTS.items()) == [("weights", 3), ("texture_gains", 3), ("colour_gains", 3)]


def test_before_fitting_all_outputs_are_zero():
    judged = Fusion()(features())
    assert judged.shape == (1, 9, 8, 12)
    assert (judged == 0).all()


def test_each_pixel_of_a_block_has_outputs_of_its_own():
    judged = random_fusion()(features())
    corners = [judged[..., y::2, x::2] for y in (0, 1) for x in (0, 1)]
    assert all(not torch.allclose(corners[0], other) for other in corners[1:])


def test_the_network_sees_three_blocks_around_a_block():
    """Two layers of 3 x 3 at half the resolution reach two blocks to each side, and no further."""
    fusion, given = random_fusion(), features(32, 32)
    before = fusion(given)
    given.fine[0, :, 16, 16] += 1
    given.coarse[0, :, 8, 8] += 1
    changed = (fusion(given) != before).any(1)[0]
    rows, columns = torch.nonzero(changed, as_tuple=True)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (12, 21, 12, 21)


def test_only_a_few_compiled_convolutions_are_kept():
    """torch reads these at the first convolution of the process."""
    assert os.environ["LRU_CACHE_CAPACITY"] == "64"
    assert os.environ["ONEDNN_PRIMITIVE_CACHE_CAPACITY"] == "64"


def test_the_gradient_of_the_mixture_by_finite_differences():
    generator = torch.Generator().manual_seed(0)
    draw = lambda *shape: torch.rand(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    judged = (draw(1, 9, 4, 4) - 0.5).requires_grad_()
    images = [draw(1, 3, 4, 4) for _ in range(3)]
    texture = [draw(1, 3, 4, 4) - 0.5 for _ in range(3)]
    assert torch.autograd.gradcheck(lambda x: mixture(x, images, texture), (judged,))


def pixel(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64).view(1, -1, 1, 1)


def test_the_mixture_of_one_pixel_by_hand():
    """Shares by softmax of (-1.5, -0.2, 0.1), splats sharpened by exp(0.23, -0.08, -0.46)."""
    judged = pixel(0.5, -0.2, 0.1, 0.7, -0.3, 0.2, 0.4, 0.0, -0.4)
    traced, denoised, splat = pixel(1, 2, 3), pixel(0.5, 0.4, 0.3), pixel(0.2, 0.6, 0.1)
    texture = [pixel(0.3, 0.1, -0.2), pixel(0.5, 0.5, 0.5), pixel(-0.1, 0, 0.1)]
    radiance, weights = mixture(judged, [traced, denoised, splat], texture)
    np.testing.assert_allclose(weights.ravel(), [0.103925, 0.381331, 0.514744], rtol=1e-5)
    # Red: 0.7 * 0.3 - 0.3 * 0.5 - 0.2 * 0.1 + 0.5 tanh 0.4 = 0.229974.
    sharp = [0.2 * np.exp(0.229974), 0.6 * np.exp(-0.08), 0.1 * np.exp(-0.459974)]
    expected = [
        0.103925 * 1 + 0.381331 * 0.5 + 0.514744 * sharp[0],
        0.103925 * 2 + 0.381331 * 0.4 + 0.514744 * sharp[1],
        0.103925 * 3 + 0.381331 * 0.3 + 0.514744 * sharp[2],
    ]
    np.testing.assert_allclose(radiance.ravel(), expected, rtol=1e-5)


def test_without_any_output_samples_count_for_little_and_splats_stay_as_they_are():
    """Softmax of (-2, 0, 0): 0.0634 and twice 0.4683."""
    images = [pixel(1, 0, 0), pixel(0, 1, 0), pixel(0, 0, 1)]
    radiance, weights = mixture(pixel(*[0] * 9), images, [pixel(1, 1, 1)] * 3)
    np.testing.assert_allclose(weights.ravel(), [0.063379, 0.468311, 0.468311], atol=1e-6)
    np.testing.assert_allclose(radiance, weights)


@pytest.mark.parametrize(("gain", "factor"), [(50.0, np.exp(2)), (-50.0, np.exp(-2))])
def test_sharpening_is_limited(gain, factor):
    judged = pixel(-99, -99, 99, gain, 0, 0, 0, 0, 0)
    radiance, _ = mixture(judged, [pixel(1, 1, 1)] * 3, [pixel(1, 1, 1)] * 3)
    np.testing.assert_allclose(radiance, factor, atol=1e-6)


def test_the_correction_of_colour_is_limited_to_half_a_logarithm():
    judged = pixel(-99, -99, 99, 0, 0, 0, 99, 0, -99)
    radiance, _ = mixture(judged, [pixel(1, 1, 1)] * 3, [pixel(1, 1, 1)] * 3)
    np.testing.assert_allclose(radiance.ravel(), np.exp([0.5, 0, -0.5]), atol=1e-6)
