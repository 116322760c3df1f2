"""The fusion: which parents it trusts, and what it excludes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.compose.fusion import plain_fusion
from tests.compose.fusion.examples import PlainParents, cropped, error, estimate, example, fuse, trusted


def flat(value: float, side: int = 32) -> np.ndarray:
    return np.full((side, side, 3), value, np.float32)


def counts(value: float, side: int = 32) -> np.ndarray:
    return np.full((side, side, 1), value, np.float32)


def trust(estimate: np.ndarray, traced: np.ndarray, variance: np.ndarray, count: np.ndarray) -> np.ndarray:
    return trusted(estimate, traced=traced, variance=variance, count=count)


def uniform(size: int = 32, count: float = 4, **values: float) -> PlainParents:
    """Uniform parents: radiance and albedo of 0.5 but for the given values, variance 0.01."""
    shape = (size, size, 3)
    names = ("traced", "variance", "denoised", "splat", "albedo")
    images = {n: np.full(shape, values.get(n, 0.01 if n == "variance" else 0.5), np.float32) for n in names}
    number = np.full((size, size, 1), count, np.float32)
    return PlainParents(**images, count=number, earlier=0 * number)


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("spp", [1, 64])
@pytest.mark.parametrize(("height", "width"), [(96, 96), (72, 45), (33, 95), (5, 3), (1, 1)])
def test_the_result_is_that_of_the_formulas(height, width, spp, quick):
    parents = cropped(example(2, spp).parents, height, width)
    parents = replace(parents, denoised=None) if quick else parents
    # Two pixels of which nothing is known, as around a disc.
    parents.variance[0, 0] = parents.variance[-1, -1] = np.inf
    found = fuse(parents)
    np.testing.assert_allclose(found.radiance, plain_fusion.fused(parents), atol=1e-4)
    unbiased = np.isfinite(parents.variance).all(2)
    np.testing.assert_array_equal(found.weights[..., 0][~unbiased], 0)


def test_images_of_other_sizes_are_fused_by_the_same_recordings():
    """The first ones are what a recording is made for, the others are of as many lanes or of multiples."""
    for size in ((64, 64), (62, 64), (61, 67), (32, 128), (96, 32), (64, 64)):
        parents = cropped(example(4, 4, 128).parents, *size)
        np.testing.assert_allclose(fuse(parents).radiance, plain_fusion.fused(parents), atol=1e-4)


def test_with_more_samples_the_traced_radiance_takes_over():
    """However wrong the other parents are, weight and radiance go to the samples and the error to theirs."""
    shares, excess = [], []
    for spp in (16, 256, 4096, 1 << 24):
        given = example(3, spp)
        wrong = replace(given.parents, splat=given.parents.splat * 0.7 + 0.1)
        fused = fuse(wrong)
        shares.append(fused.weights[..., 0].mean())
        excess.append(error(fused.radiance, given.radiance) - error(wrong.traced, given.radiance))
    # In between, the denoised samples may be preferred to the others.
    assert shares[1:] == sorted(shares[1:])
    assert shares[-1] > 0.99
    assert abs(excess[-1]) < 0.1


@pytest.mark.parametrize("spp", [4, 64])
def test_weights_sum_to_one(spp):
    fused = fuse(example(5, spp).parents)
    np.testing.assert_allclose(fused.weights.sum(axis=2), 1, atol=1e-5)
    assert fused.weights.min() >= 0
    assert fused.excluded == 0


def test_parents_that_agree_are_kept_at_any_scale():
    """Radiance is linear and unbounded: a lamp of radiance 5000 stays one."""
    agreed = replace(uniform(), traced=lamp(), denoised=lamp(), splat=lamp(), variance=0 * lamp())
    np.testing.assert_allclose(fuse(agreed).radiance, 5000, rtol=1e-3)


def lamp() -> np.ndarray:
    return np.full((32, 32, 3), 5000, np.float32)


@pytest.mark.parametrize(("height", "width"), [(65, 71), (64, 71), (65, 70)])
def test_odd_sizes_are_fused_like_even_ones(height, width):
    """Away from the last row and column, padding hardly makes a difference."""
    given = example(7, 4).parents
    whole, part = (fuse(parents) for parents in (cropped(given, 72, 72), cropped(given, height, width)))
    assert part.radiance.shape == (height, width, 3)
    assert part.weights.shape == (height, width, 4)
    # At a quarter of the resolution an odd side is a fraction of a pixel longer, so they agree only nearly.
    assert error(part.radiance[:40, :40], whole.radiance[:40, :40]) < -42


@pytest.mark.parametrize("name", ["traced", "denoised", "splat"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_an_invalid_parent_is_left_out_and_counted(name, value):
    given = example(6, 4)
    image = getattr(given.parents, name).copy()
    image[10, 20, 1] = image[30, 40] = value
    before = image.copy()
    fused = fuse(replace(given.parents, **{name: image}))
    assert fused.excluded == 2
    assert np.isfinite(fused.radiance).all()
    assert fused.radiance.min() >= 0
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        (("traced",), 0.5),
        (("denoised",), 0.5),
        (("splat",), 0.5),
        (("traced", "splat"), 0.5),
        (("denoised", "splat"), 0.0),
        (("traced", "denoised", "splat"), 0.0),
    ],
)
def test_the_other_parents_stand_in_for_an_invalid_one(bad, expected):
    """All are 0.5 but for one pixel; without denoised samples and splats only the samples are left there."""
    given = uniform()
    for name in bad:
        getattr(given, name)[16, 16] = np.nan
    fused = fuse(given)
    assert fused.excluded == 1
    if bad == ("denoised", "splat"):
        assert 0 <= fused.radiance[16, 16].max() <= 0.5
    else:
        np.testing.assert_allclose(fused.radiance[16, 16], expected, atol=1e-3)
    np.testing.assert_allclose(fused.radiance[4, 4], 0.5, atol=1e-3)


def test_an_invalid_sample_is_not_trusted_to_correct_the_estimate():
    """The samples are black where the other parents are 0.5; in an invalid pixel the estimate is kept."""
    given = uniform(traced=0.0, variance=1e-6)
    given.traced[16, 16] = np.nan
    fused, kept = fuse(given), estimate(given)
    np.testing.assert_allclose(fused.radiance[16, 16], kept[16, 16], rtol=1e-3)
    assert kept[4, 4].min() > 0.05
    assert fused.radiance[4, 4].max() < 0.01


def test_an_invalid_albedo_does_not_spread():
    given = example(6, 4).parents
    image = np.array(given.albedo)
    image[10, 20] = np.nan
    image[30, 40] = -np.inf
    fused = fuse(replace(given, albedo=image))
    assert fused.excluded == 0
    assert np.isfinite(fused.radiance).all()


def test_a_pixel_of_unknown_variance_says_nothing_about_its_neighbours():
    """It counts as one without noise among nine blocks of four pixels: a 36th less noise at most."""
    traced = flat(1.2)
    variance = flat(0.01)
    variance[16, 16] = np.inf
    share = trust(flat(1), traced, variance, counts(64))
    assert share[16, 16] == 1
    np.testing.assert_allclose(share[17, 17], 0.25, rtol=0.05)


def test_noise_alone_does_not_count_as_bias():
    """An exact estimate keeps nearly all of its share beside noisy samples, a biased one does not."""
    given = example(4, 4)
    truth, traced, variance, count = (
        given.radiance,
        *map(vars(given.parents).get, ("traced", "variance", "count")),
    )
    assert trust(truth, traced, variance, count).mean() > 0.97
    many = np.full_like(count, 1024)
    biased = truth + 3 * np.sqrt(variance).mean()
    assert trust(biased, traced, variance, many).mean() < 0.3


def test_trust_without_noise_by_hand():
    """v / (v + d^2 - v): 0.01 over 0.04; where only the floor of bias is left, 1e-5 over 1e-5 + 0.005^2."""
    share = trust(flat(1), flat(1.2), flat(0.01), counts(64))
    np.testing.assert_allclose(share, 0.25, atol=1e-4)
    share = trust(flat(1), flat(1 + 1e-5**0.5), flat(1e-5), counts(64))
    np.testing.assert_allclose(share, 0.28571, atol=1e-3)
    assert (trust(flat(1), flat(5), flat(np.inf), counts(1)) == 1).all()


@pytest.mark.parametrize(("count", "expected"), [(1, 0.03782), (400, 0.01552)])
def test_a_single_outlier_among_few_samples_counts_less(count, expected):
    """One of 32 x 32 pixels differs by 5, with a variance of 0.01 everywhere.

    Over 6 x 6 pixels the excess is 24.99 / 36 less 0.01 of the others, 0.6844. Twice an error is subtracted,
    which is at most 0.01 (1.5 + 20 / sqrt(count)): 0.43 for one sample and 0.05 for 400.
    """
    traced = flat(1)
    traced[16, 16] = 6
    share = trust(flat(1), traced, flat(0.01), counts(count))
    np.testing.assert_allclose(share[16, 16], expected, rtol=2e-3)
    assert share[2, 2] > 0.9


def test_black_samples_are_as_uncertain_as_their_neighbourhood():
    """A patch in which single samples have found no light shows no variance, but its neighbourhood does."""
    variance, noise = flat(0.25, 64), np.random.default_rng(0).normal(size=(64, 64, 3))
    traced = 1 + 0.5 * noise.astype(np.float32)
    variance[24:36, 24:36] = 0
    traced[24:36, 24:36] = 0
    share = trust(flat(1, 64), traced, variance, counts(1, 64))
    assert share[28:32, 28:32].min() > 0.1
    # Without any variance around it, it would be believed.
    assert trust(flat(1, 64), traced, 0 * variance, counts(1, 64))[28:32, 28:32].max() < 1e-6
