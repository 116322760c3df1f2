"""The loss is what it is made of, and its gradient is right."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splat.training.loss import SMALLEST_SIDE, SSIM_WEIGHT, Target


def images(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    a, b = np.random.default_rng(0).uniform(size=(2, *shape)).astype(np.float32)
    return a, b


def test_ssim_is_that_of_scikit_image():
    from skimage.metrics import structural_similarity

    a, b = images((40, 30, 3))
    target = Target(torch.from_numpy(b))
    expected = structural_similarity(
        a,
        target.seen.numpy(),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=2,
        full=True,
    )[1][5:-5, 5:-5].mean()
    assert target.ssim(torch.from_numpy(a)).item() == pytest.approx(expected, abs=1e-5)


def test_equal_images_have_no_loss():
    radiance = torch.from_numpy(images((12, 13, 3))[0]) * 5
    loss, error = Target(radiance).loss(radiance)
    assert loss.item() == pytest.approx(0, abs=1e-6)
    assert (error == 0).all()


def test_the_loss_weighs_difference_and_similarity():
    """Constant images of 0.0 and 1.0 differ by 1; their similarity is C1 / (1 + C1) with C1 = 1e-4."""
    loss, error = Target(torch.ones(11, 11, 3)).loss(torch.zeros(11, 11, 3))
    similarity = 1e-4 / (1 + 1e-4)
    assert loss.item() == pytest.approx(0.8 * 1 + 0.2 * (1 - similarity), rel=1e-5)
    assert SSIM_WEIGHT == 0.2
    torch.testing.assert_close(error, torch.ones(11, 11))


def test_the_error_is_per_pixel_and_has_no_gradient():
    """Radiance 0.5 in one channel is 0.7354 on the sRGB curve; its third is the pixel's error."""
    rendered = torch.zeros(20, 15, 3)
    rendered[4, 7, 1] = 0.5
    rendered.requires_grad_()
    _, error = Target(torch.zeros(20, 15, 3)).loss(rendered)
    assert error.shape == (20, 15)
    assert not error.requires_grad
    assert error[4, 7].item() == pytest.approx(0.7354 / 3, abs=1e-4)
    assert error.sum().item() == error[4, 7].item()


def test_a_lamp_counts_logarithmically():
    """Twice too bright costs the same at 10 and at 1000."""
    losses = []
    for lamp in (10.0, 1000.0):
        _, error = Target(torch.full((11, 11, 3), lamp)).loss(torch.full((11, 11, 3), 2 * lamp))
        losses.append(error.mean().item())
    assert losses[0] == pytest.approx(losses[1], rel=1e-4)
    assert losses[0] == pytest.approx(np.log(2) * 1.055 / 2.4, rel=1e-4)


def test_the_gradient_equals_finite_differences():
    rng = np.random.default_rng(0)
    image = torch.tensor(rng.uniform(0.05, 3, (14, 13, 3)), dtype=torch.float64, requires_grad=True)
    target = Target(torch.tensor(rng.uniform(0.05, 3, (14, 13, 3)), dtype=torch.float64))
    assert torch.autograd.gradcheck(lambda x: target.loss(x)[0], image, atol=1e-6, fast_mode=True)


def test_the_smallest_image_holds_one_window():
    assert SMALLEST_SIDE == 11
    assert Target(torch.zeros(11, 11, 3)).mean.shape == (3, 1, 1)
