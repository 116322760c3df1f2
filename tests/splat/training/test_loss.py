"""The loss is what it is made of, and its gradient is right."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splat.training.loss import SMALLEST_SIDE, SSIM_WEIGHT, FrameTarget
from tests.splat.training import reference


def images(shape: tuple[int, ...], largest: float = 1.0) -> tuple[torch.Tensor, torch.Tensor]:
    a, b = np.random.default_rng(0).uniform(0, largest, (2, *shape)).astype(np.float32)
    return torch.from_numpy(a), torch.from_numpy(b)


# One window; sides that runs of the kernels do not divide; one window across or down; several of each.
@pytest.mark.parametrize("shape", [(11, 11), (11, 40), (23, 11), (18, 19), (33, 26)])
def test_loss_and_gradient_equal_the_twins(arrays, shape):
    rendered, target = images((*shape, 3), largest=2.5)
    rendered.requires_grad_()
    loss, _ = FrameTarget(arrays, target).loss(rendered)
    (3 * loss).backward()
    exact = rendered.detach().double().requires_grad_()
    expected = reference.loss(exact, target.double())
    (3 * expected).backward()
    assert loss.item() == pytest.approx(expected.item(), abs=1e-6)
    assert (rendered.grad - exact.grad).abs().max() < 1e-5 * exact.grad.abs().max()


def test_a_frame_in_half_precision_is_compared_as_it_is(arrays):
    rendered, target = images((18, 19, 3), largest=2.5)
    target = target.half()
    loss, _ = FrameTarget(arrays, target).loss(rendered)
    assert loss.item() == pytest.approx(reference.loss(rendered.double(), target.double()).item(), abs=1e-6)


def test_the_twins_gradient_equals_finite_differences():
    rng = np.random.default_rng(0)
    image = torch.tensor(rng.uniform(0.05, 3, (14, 13, 3)), dtype=torch.float64, requires_grad=True)
    target = torch.tensor(rng.uniform(0.05, 3, (14, 13, 3)), dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: reference.loss(x, target), image, atol=1e-6, fast_mode=True)


def test_the_twins_similarity_is_that_of_scikit_image():
    from skimage.metrics import structural_similarity

    a, b = (image.double() for image in images((40, 30, 3)))
    expected = structural_similarity(
        a.numpy(),
        b.numpy(),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=2,
        full=True,
    )[1][5:-5, 5:-5].mean()
    assert reference.ssim(a, b).item() == pytest.approx(expected, abs=1e-9)


def test_equal_images_have_no_loss(arrays):
    radiance = images((12, 13, 3))[0] * 5
    loss, error = FrameTarget(arrays, radiance).loss(radiance)
    assert loss.item() == pytest.approx(0, abs=1e-6)
    assert (error == 0).all()


def test_the_loss_weighs_difference_and_similarity(arrays):
    """Constant images of 0.0 and 1.0 differ by 1; their similarity is C1 / (1 + C1) with C1 = 1e-4."""
    loss, error = FrameTarget(arrays, torch.ones(11, 11, 3)).loss(torch.zeros(11, 11, 3))
    similarity = 1e-4 / (1 + 1e-4)
    assert loss.item() == pytest.approx(0.8 * 1 + 0.2 * (1 - similarity), rel=1e-5)
    assert SSIM_WEIGHT == 0.2
    torch.testing.assert_close(error, torch.ones(11, 11))


def test_the_error_is_per_pixel_and_has_no_gradient(arrays):
    """Radiance 0.5 in one channel is 0.7354 on the sRGB curve; its third is the pixel's error."""
    rendered = torch.zeros(20, 15, 3)
    rendered[4, 7, 1] = 0.5
    rendered.requires_grad_()
    _, error = FrameTarget(arrays, torch.zeros(20, 15, 3)).loss(rendered)
    assert error.shape == (20, 15)
    assert not error.requires_grad
    assert error[4, 7].item() == pytest.approx(0.7354 / 3, abs=1e-4)
    assert error.sum().item() == error[4, 7].item()


def test_the_scale_is_the_logarithmic_one(arrays):
    """The mean error of a constant frame against black is its own value on the scale."""
    black = FrameTarget(arrays, torch.zeros(11, 11, 3))
    for radiance in (-0.5, 0.002, 0.0031308, 0.2, 1.0, 1.5, 40.0, 1e9):
        expected = abs(reference.logarithmic(torch.tensor(radiance)).item())
        _, error = black.loss(torch.full((11, 11, 3), radiance))
        assert error.mean().item() == pytest.approx(expected, rel=1e-5), radiance


def test_a_lamp_counts_logarithmically(arrays):
    """Twice too bright costs the same at 10 and at 1000."""
    losses = []
    for lamp in (10.0, 1000.0):
        target = FrameTarget(arrays, torch.full((11, 11, 3), lamp))
        losses.append(target.loss(torch.full((11, 11, 3), 2 * lamp))[1].mean().item())
    assert losses[0] == pytest.approx(losses[1], rel=1e-4)
    assert losses[0] == pytest.approx(np.log(2) * 1.055 / 2.4, rel=1e-4)


@pytest.mark.parametrize("broken", [float("nan"), float("inf")])
def test_a_broken_pixel_gives_a_loss_that_is_not_finite(arrays, broken):
    rendered, target = images((24, 30, 3))
    rendered[7, 20, 1] = broken
    assert not torch.isfinite(FrameTarget(arrays, target).loss(rendered)[0])


def test_the_smallest_image_holds_one_window():
    assert SMALLEST_SIDE == 11
