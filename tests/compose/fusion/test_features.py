"""What the network sees."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from compose.fusion.features import Features, features_of, perceived
from compose.fusion.parents import Parents, as_batch
from tests.compose.fusion.examples import example

SIZE = 96


def seen(parents: Parents, count: float | None = None, enlargement: float = 1.0) -> Features:
    names = ("traced", "denoised", "splat", "albedo", "normal")
    images = [as_batch(getattr(parents, name)) for name in names]
    counts = as_batch(parents.count) if count is None else torch.full((1, 1, SIZE, SIZE), count)
    return features_of(images, counts, torch.tensor([enlargement]), torch.tensor([0.0]))


def flat(**values: float) -> Parents:
    """Uniform parents: 0.25 but for the given ones."""
    shape = (SIZE, SIZE, 3)
    names = ("traced", "variance", "denoised", "splat", "albedo", "normal")
    images = {name: np.full(shape, values.get(name, 0.25), dtype=np.float32) for name in names}
    return Parents(**images, count=np.ones((SIZE, SIZE, 1), np.float32), enlargement=1.0)


def coarse(features: Features) -> dict[str, torch.Tensor]:
    return Features.COARSE.parts(features.coarse)


def fine(features: Features) -> dict[str, torch.Tensor]:
    return Features.FINE.parts(features.fine)


def test_networks_in_files_depend_on_the_order_of_channels():
    assert dict(Features.FINE) == {"splat": 3, "difference": 3, "texture": 3, "residual": 1}
    assert list(Features.FINE) == ["splat", "difference", "texture", "residual"]
    assert list(Features.COARSE.items()) == [
        ("albedo", 3),
        ("normal", 3),
        ("texture_6", 3),
        ("texture_12", 3),
        ("ratio_6", 1),
        ("evidence_6", 1),
        ("ratio_12", 1),
        ("evidence_12", 1),
        ("residual", 1),
        ("residual_power", 1),
        ("difference", 1),
        ("count", 1),
        ("enlargement", 1),
        ("quick", 1),
    ]
    assert (Features.FINE.total, Features.COARSE.total) == (10, 22)


def test_shapes():
    features = seen(example(10, 1).parents)
    assert features.fine.shape == (1, 10, SIZE, SIZE)
    assert features.coarse.shape == (1, 22, SIZE // 2, SIZE // 2)
    assert [tuple(t.shape) for t in features.texture] == [(1, 3, SIZE, SIZE)] * 3


@pytest.mark.parametrize("scale", [0.0, 1e-6, 1e6])
def test_features_are_finite_at_the_extremes(scale):
    given = example(10, 1).parents
    images = [as_batch(i) for i in (given.traced * scale, given.denoised * scale)]
    images += [as_batch(i) for i in (given.splat, given.albedo, given.normal)]
    features = features_of(images, torch.ones(1, 1, SIZE, SIZE), torch.tensor([1.0]), torch.tensor([1.0]))
    assert features.fine.isfinite().all()
    assert features.coarse.isfinite().all()


def test_perceived_radiance_by_hand():
    """sqrt(v + 0.001) up to 1, plus 2 (v^(1/4) - 1) beyond."""
    values = torch.tensor([0.0, 0.249, 1.0, 16.0])
    np.testing.assert_allclose(perceived(values), [0.0316228, 0.5, 1.0005, 3.0005], atol=1e-5)


def test_perceived_radiance_rises_ever_more_slowly():
    values = perceived(torch.linspace(0, 100, 10_001, dtype=torch.float64))
    slope = values.diff()
    assert (slope > 0).all()
    assert (slope.diff()[:98] < 0).all()
    assert (slope.diff()[101:] < 0).all()


def test_uniform_images_by_hand():
    """Denoised 0.999, splat 0.249 and traced 0.999: perceived 1 and 0.5."""
    found = seen(flat(traced=0.999, denoised=0.999, splat=0.249, albedo=0.47, normal=-0.3))
    parts = fine(found)
    np.testing.assert_allclose(parts["splat"], 0.5, atol=1e-5)
    np.testing.assert_allclose(parts["difference"], 0.5, atol=1e-5)
    np.testing.assert_allclose(parts["texture"], 0, atol=1e-5)
    np.testing.assert_allclose(parts["residual"], 0, atol=1e-5)
    parts = coarse(found)
    np.testing.assert_allclose(parts["albedo"], 0.47, atol=1e-6)
    np.testing.assert_allclose(parts["normal"], -0.3, atol=1e-6)
    np.testing.assert_allclose(parts["difference"], 0.5, atol=1e-5)
    np.testing.assert_allclose(parts["residual"], 0, atol=1e-6)
    # log(1e-5) / 4.
    np.testing.assert_allclose(parts["residual_power"], -2.87823, atol=1e-3)


def test_the_residual_is_what_denoising_removed():
    """Perceived 1 before and 0.5 after; its mean square is 0.25, and log(0.25) / 4 = -0.34657."""
    found = seen(flat(traced=0.999, denoised=0.249))
    np.testing.assert_allclose(fine(found)["residual"], 0.5, atol=1e-5)
    np.testing.assert_allclose(coarse(found)["residual"], 0.5, atol=1e-5)
    np.testing.assert_allclose(coarse(found)["residual_power"], -0.34657, atol=1e-4)


@pytest.mark.parametrize(("count", "expected"), [(0.5, -1), (1, -1), (8, 0), (64, 1), (1000, 1)])
def test_the_count_is_logarithmic_from_1_to_64(count, expected):
    np.testing.assert_allclose(coarse(seen(flat(), count))["count"], expected, atol=1e-6)


@pytest.mark.parametrize(
    ("enlargement", "expected"), [(0.01, -2), (0.5, -1), (1, 0), (4, 2), (16, 4), (99, 4)]
)
def test_the_enlargement_is_logarithmic_from_a_quarter_to_16(enlargement, expected):
    found = coarse(seen(flat(), enlargement=enlargement))["enlargement"]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_texture_is_what_a_blur_removes_from_the_albedo():
    """A black stripe, 1 pixel wide, in white: windows of 3 pixels hold a third of it, larger ones less.

    In it, log 0.03 minus log(2 / 3 + 0.03); halving mixes it with a white column first.
    """
    given = flat(albedo=1.0)
    given.albedo[:, 48] = 0
    features = seen(given)
    in_stripe = [float(t[0, 0, 48, 48]) for t in features.texture]
    assert in_stripe[0] == pytest.approx(np.log(0.03) - np.log(2 / 3 + 0.03), abs=1e-4)
    # Windows of 6 pixels at half the resolution: (1/2 + 1 + 1) / 3 around the stripe and 1 further away, of
    # which bilinear interpolation takes 3/4 and 1/4.
    near = np.log(2.5 / 3 + 0.03)
    assert in_stripe[1] == pytest.approx(np.log(0.03) - near, abs=1e-4)
    assert in_stripe[0] > in_stripe[1] > in_stripe[2]
    np.testing.assert_allclose(features.texture[0][..., :40], 0, atol=1e-6)
    assert torch.equal(fine(features)["texture"], features.texture[0])
    parts = coarse(features)
    assert float(parts["texture_6"][0, 0, 24, 24]) == pytest.approx(np.log(0.53) - near, abs=1e-4)
    assert float(parts["texture_12"][0, 0, 24, 24]) < float(parts["texture_6"][0, 0, 24, 24])


def test_the_ratio_of_samples_to_splats():
    """(0.55 + 0.05) / (0.25 + 0.05) - 1 = 1, which is also the limit; (0.1 + 0.05) / 0.3 - 1 = -0.5."""
    for traced, expected in ((0.55, 1.0), (0.1, -0.5), (0.25, 0.0), (9.0, 1.0)):
        parts = coarse(seen(flat(traced=traced)))
        np.testing.assert_allclose(parts["ratio_6"], expected, atol=1e-5)
        np.testing.assert_allclose(parts["ratio_12"], expected, atol=1e-5)


def test_a_single_bright_sample_counts_as_eight_times_the_splats_at_most():
    """One of the 36 pixels of a window, and one of the 144 of a large one."""
    given = flat()
    given.traced[48, 48] = 1000
    parts = coarse(seen(given))
    assert float(parts["ratio_6"][0, 0, 24, 24]) == pytest.approx(8 / 36, abs=1e-5)
    assert float(parts["ratio_12"].max()) == pytest.approx(8 / 144, abs=1e-5)


def test_evidence_of_a_difference_without_noise():
    """t = -0.5 / sqrt(0.0001), and t / (3 + |t|)."""
    parts = coarse(seen(flat(traced=0.1)))
    np.testing.assert_allclose(parts["evidence_6"], -50 / 53, atol=1e-4)
    np.testing.assert_allclose(parts["evidence_12"], -50 / 53, atol=1e-4)


def noisy(mean: float) -> dict[str, torch.Tensor]:
    """Coarse features of samples around a mean, with a spread of 1, beside splats of 0.25."""
    rng = np.random.default_rng(0)
    given = flat()
    given.traced[:] = mean * rng.exponential(size=(SIZE, SIZE, 1))
    return coarse(seen(given))


def test_noise_is_no_evidence_and_many_pixels_tell_more_than_few():
    same, other = noisy(0.25), noisy(0.75)
    for name in ("evidence_6", "evidence_12"):
        # t-values of 1 and 2 become 0.25 and 0.4.
        assert same[name].abs().mean() < 0.3
        assert other[name].mean() > same[name].abs().mean() + 0.2
    assert other["evidence_12"].mean() > other["evidence_6"].mean() + 0.05
    assert same["ratio_12"].std() < 0.7 * same["ratio_6"].std()


def test_a_dark_window_shows_no_evidence_before_light_was_found_anywhere_near():
    """One pixel in a hundred holds all the light: windows without one differ from the splats by chance.

    Without the variance of the whole image their t-value would be -0.83 / 0.01, which shows as -0.965.
    """
    rng = np.random.default_rng(0)
    given = flat()
    given.traced[:] = 25 * (rng.uniform(size=(SIZE, SIZE, 1)) < 0.01)
    parts = coarse(seen(given))
    dark = parts["ratio_6"] < -0.8
    assert dark.float().mean() > 0.3
    assert parts["evidence_6"][dark].abs().max() < 0.8
