"""The fusion: what it trusts, what it refuses, and that fitting it pays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from compose.fusion import fitting
from compose.fusion.combination import fuse, regressed, trust
from compose.fusion.features import features_of
from compose.fusion.fitting import Example, fit
from compose.fusion.network import Fusion, mixture
from compose.fusion.parents import Parents
from tests import small


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    return gaussian_filter(image, (sigma, sigma, 0)).astype(np.float32)


def example(seed: int, spp: int, size: int = 96) -> Example:
    """A textured wall in soft light: splats that blur, samples that are noisy, a denoiser that blurs more."""
    rng = small.rng(seed)
    albedo = np.kron(rng.uniform(0.1, 0.9, (size // 8, size // 8, 3)), np.ones((8, 8, 1))).astype(np.float32)
    light = 2 * blurred(rng.uniform(0, 1, (size, size, 1)).astype(np.float32), 16) ** 2 + 0.3
    truth = (albedo * light).astype(np.float32)
    traced = (truth * rng.gamma(spp / 2, 2 / spp, truth.shape)).astype(np.float32)
    denoised = blurred(traced / (albedo + 0.01), 2) * (albedo + 0.01)
    shape = (size, size, 3)
    variance = np.broadcast_to(truth**2 * 2 / spp, shape).astype(np.float32)
    parents = Parents(
        traced,
        variance,
        denoised.astype(np.float32),
        blurred(truth, 1.5),
        albedo,
        np.broadcast_to(np.float32([0, 0, 1]), shape),
        np.full((size, size, 1), spp, dtype=np.float32),
        2.0,
    )
    return Example(parents, truth)


def error(image: np.ndarray, truth: np.ndarray) -> float:
    """Mean squared error in dB."""
    return 10 * np.log10(np.mean((image - truth) ** 2))


def random_fusion() -> Fusion:
    """As it is before fitting, but with opinions."""
    torch.manual_seed(0)
    fusion = Fusion()
    torch.nn.init.normal_(fusion.judge.weight, std=0.3)
    return fusion.eval()


@pytest.fixture(scope="module")
def fitted() -> Fusion:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "ITERATIONS", 250)
        examples = [example(seed, spp) for seed in range(3) for spp in (2, 16)]
        return fit(examples, 0, lambda done, total: None)


@pytest.mark.parametrize("spp", [2, 16])
def test_fused_is_better_than_the_better_parent(fitted, spp):
    given = example(11, spp)
    fused = fuse(given.parents, fitted)
    best = min(error(getattr(given.parents, name), given.reference) for name in ("splat", "denoised"))
    assert error(fused.radiance, given.reference) < best - 0.5


def test_splats_of_another_world_are_noticed(fitted):
    """Something moved: no worse than the denoised samples, by 0.2 dB."""
    given = example(12, 16)
    moved = replace(given.parents, splat=np.roll(given.parents.splat, 20, axis=0))
    fused = fuse(moved, fitted)
    assert error(fused.radiance, given.reference) < error(given.parents.denoised, given.reference) + 0.2


def test_fitting_again_gives_the_same(monkeypatch):
    monkeypatch.setattr(fitting, "ITERATIONS", 3)
    states = [fit([example(0, 4)], 5, lambda done, total: None).state_dict() for _ in range(2)]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])


@pytest.mark.parametrize("fusion", [None, random_fusion()], ids=["statistical", "unfitted"])
def test_with_more_samples_the_traced_radiance_takes_over(fusion):
    """However wrong the other parents are: weight and radiance go to the samples, and the error to theirs."""
    shares, excess = [], []
    for spp in (16, 256, 4096, 1 << 24):
        given = example(3, spp)
        wrong = replace(given.parents, splat=given.parents.splat * 0.7 + 0.1)
        fused = fuse(wrong, fusion)
        shares.append(fused.weights[..., 0].mean())
        excess.append(error(fused.radiance, given.reference) - error(wrong.traced, given.reference))
    # In between, the denoised samples may be preferred to the others.
    assert shares[1:] == sorted(shares[1:])
    assert shares[-1] > 0.99
    assert abs(excess[-1]) < 0.1


def test_noise_alone_is_not_taken_for_bias():
    """An exact estimate beside noisy samples keeps nearly all of its share."""
    given = example(4, 4)
    batch = lambda image: torch.from_numpy(image.copy()).permute(2, 0, 1)[None]  # noqa: E731
    truth, traced = batch(given.reference), batch(given.parents.traced)
    variance = batch(given.parents.variance)
    count = torch.full_like(truth[:, :1], 4)
    assert trust(truth, traced, variance, count).mean() > 0.97
    many = torch.full_like(count, 1024)
    biased = truth + 3 * variance.sqrt().mean()
    assert trust(biased, traced, variance, many).mean() < 0.3


def way(length: float, at: float, noise: float) -> np.ndarray:
    """(N,) shares of the way found between two flat pictures, where the truth lies at that share."""
    start, end = torch.full((1, 3, 96, 96), 0.5), torch.full((1, 3, 96, 96), 0.5 + length)
    generator = torch.Generator().manual_seed(0)
    traced = start + at * length + noise * torch.randn(start.shape, generator=generator)
    return regressed(start, end, traced, torch.full_like(start, noise**2)).numpy().ravel()


def test_many_samples_tell_which_of_two_estimates_is_nearer():
    for at in (0.0, 0.4, 1.0):
        np.testing.assert_allclose(way(0.1, at, 1e-4), at, atol=0.02)
    np.testing.assert_allclose(way(0.1, 1.7, 1e-4), 1, atol=0.02)
    np.testing.assert_allclose(way(0.1, -0.5, 1e-4), 0, atol=0.02)


def test_few_samples_leave_the_first_estimate_as_it_is():
    """Their noise would choose at random; the share is a tenth of it, at most."""
    assert way(0.02, 1.0, 0.3).max() < 0.12
    assert way(0.02, 0.0, 0.3).max() < 0.12


def test_weights_are_shares():
    fused = fuse(example(5, 4).parents, random_fusion())
    np.testing.assert_allclose(fused.weights.sum(axis=2), 1, atol=1e-5)
    assert fused.weights.min() >= 0
    assert fused.excluded == 0


@pytest.mark.parametrize("name", ["traced", "denoised", "splat"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_what_is_no_radiance_is_left_out_and_counted(name, value):
    given = example(6, 4)
    image = getattr(given.parents, name).copy()
    image[10, 20, 1] = image[30, 40] = value
    fused = fuse(replace(given.parents, **{name: image}), random_fusion())
    assert fused.excluded == 2
    assert np.isfinite(fused.radiance).all()
    assert fused.radiance.min() >= 0


def test_odd_sizes_are_fused_as_well():
    given = example(7, 4).parents
    names = ("traced", "variance", "denoised", "splat", "albedo", "normal", "count")
    odd = replace(given, **{name: getattr(given, name)[:65, :71] for name in names})
    assert fuse(odd, random_fusion()).radiance.shape == (65, 71, 3)


def test_parents_of_different_size_are_refused():
    given = example(8, 4).parents
    with pytest.raises(ValueError, match="splat is"):
        replace(given, splat=given.splat[:-1])


def test_radiance_beyond_one_keeps_its_scale():
    """Linear and unbounded: where all parents agree on a lamp of radiance 5000, so does the result."""
    given = example(9, 4).parents
    lamp = np.full_like(given.traced, 5000)
    agreed = replace(given, traced=lamp, denoised=lamp, splat=lamp, variance=np.zeros_like(lamp))
    np.testing.assert_allclose(fuse(agreed, random_fusion()).radiance, 5000, rtol=1e-3)


def test_the_gradient_of_the_mixture_by_finite_differences():
    generator = torch.Generator().manual_seed(0)
    draw = lambda *shape: torch.rand(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    judged = (draw(1, 9, 4, 4) - 0.5).requires_grad_()
    images = [draw(1, 3, 4, 4) for _ in range(3)]
    texture = [draw(1, 3, 4, 4) - 0.5 for _ in range(3)]
    assert torch.autograd.gradcheck(lambda x: mixture(x, images, texture), (judged,))


def test_the_mixture_in_plain_words():
    """One pixel, by hand: shares by softmax, splats sharpened by the texture that they lack."""
    judged = torch.tensor([0.5, -0.2, 0.1, 0.7, -0.3, 0.2, 0.4, 0.0, -0.4], dtype=torch.float64)
    pixel = lambda *values: torch.tensor(values, dtype=torch.float64).view(1, 3, 1, 1)  # noqa: E731
    traced, denoised, splat = pixel(1, 2, 3), pixel(0.5, 0.4, 0.3), pixel(0.2, 0.6, 0.1)
    texture = [pixel(0.3, 0.1, -0.2), pixel(0.5, 0.5, 0.5), pixel(-0.1, 0, 0.1)]
    radiance, weights = mixture(judged.view(1, 9, 1, 1), [traced, denoised, splat], texture)
    values = judged.numpy()
    share = np.exp([values[0] - 2, values[1], values[2]])
    share /= share.sum()
    lacks = sum(k * t.numpy().ravel() for k, t in zip(values[3:6], texture, strict=True))
    sharp = splat.numpy().ravel() * np.exp(lacks + 0.5 * np.tanh(values[6:9]))
    expected = share[0] * traced.numpy().ravel() + share[1] * denoised.numpy().ravel() + share[2] * sharp
    np.testing.assert_allclose(radiance.numpy().ravel(), expected, rtol=1e-12)
    np.testing.assert_allclose(weights.numpy().ravel(), share, rtol=1e-12)


def test_looks_are_finite_at_the_extremes():
    given = example(10, 1).parents
    for scale in (0.0, 1e-6, 1e6):
        images = [
            torch.from_numpy(np.ascontiguousarray(i)).permute(2, 0, 1)[None]
            for i in (given.traced * scale, given.denoised * scale, given.splat, given.albedo, given.normal)
        ]
        features = features_of(images, torch.ones(1, 1, 96, 96), torch.tensor([1.0]))
        assert features.fine.isfinite().all()
        assert features.coarse.isfinite().all()
        assert features.fine.shape[1] == features.FINE
        assert features.coarse.shape[1] == features.COARSE
