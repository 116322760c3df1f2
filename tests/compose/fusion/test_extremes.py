"""The fusion at the ends: fireflies, black and blinding scenes, splats that are broken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from tests.compose.fusion import plain_fusion
from tests.compose.fusion.examples import PlainParents, example, fuse, trusted
from tests.extremes import extreme

LARGEST = float(np.finfo(np.float32).max)
SPOT = (40, 50)


def with_firefly(parents: PlainParents, radiance: float, spp: int) -> PlainParents:
    """Parents whose samples include one of a radiance, among `spp`, in one pixel."""
    traced, variance = parents.traced.copy(), parents.variance.copy()
    traced[SPOT] = radiance / spp
    with np.errstate(over="ignore"):
        variance[SPOT] = np.float32(radiance / spp) ** 2
    return replace(parents, traced=traced, variance=variance)


@pytest.mark.parametrize(
    "radiance",
    [
        pytest.param(
            radiance,
            marks=extreme(
                f"a firefly of {name}",
                given="one pixel of 96x96, 4 spp",
                expected="1 excluded; others as before",
            ),
        )
        for name, radiance in (("1e15", 1e15), ("1e30", 1e30), ("float32's maximum", LARGEST))
    ],
)
def test_a_firefly_leaves_all_other_pixels_as_they_were(radiance, got):
    """As they are where nothing at all is known of its pixel; far away they hardly change."""
    given = example(6, 4).parents
    fused = fuse(with_firefly(given, radiance, 4))
    unknown = given.traced.copy()
    unknown[SPOT] = np.nan
    expected, ordinary = fuse(replace(given, traced=unknown)), fuse(given)
    assert np.isfinite(fused.radiance).all()
    assert got(fused.excluded) == 1
    np.testing.assert_array_equal(fused.radiance, expected.radiance)
    far = np.ones(fused.radiance.shape[:2], dtype=bool)
    far[SPOT[0] - 24 : SPOT[0] + 24, SPOT[1] - 24 : SPOT[1] + 24] = False
    # One number of the image says how much texture the splats lack.
    np.testing.assert_allclose(fused.radiance[far], ordinary.radiance[far], rtol=3e-5)
    near = np.abs(fused.radiance - ordinary.radiance)
    near[SPOT] = 0
    assert got(float(near.max()), ".1e") < 0.1
    np.testing.assert_allclose(fused.weights.sum(axis=2), 1, atol=1e-5)


@pytest.mark.parametrize("radiance", [5.0, 100.0, 1e6])
def test_samples_that_are_only_bright_are_kept(radiance):
    assert fuse(with_firefly(example(6, 4).parents, radiance, 4)).excluded == 0


@pytest.mark.parametrize(
    "radiance",
    [
        pytest.param(
            r, marks=extreme(f"radiance {r:g} in all parents", given="64x64, 4 spp", expected="kept")
        )
        for r in (0.0, 1e-8, 1e6, 1e15, 1e30)
    ],
)
def test_uniform_radiance_of_any_size_is_kept(radiance, got):
    image, one = np.full((64, 64, 3), radiance, np.float32), np.full((64, 64, 3), 0.5, np.float32)
    none = 0 * one[..., :1]
    fused = fuse(PlainParents(image, np.zeros_like(image), image, one, 4 + none, none, image))
    assert fused.excluded == 0
    assert got(float(np.abs(fused.radiance - radiance).max()), ".1e") <= 1e-3 * radiance


@pytest.mark.parametrize(
    "value",
    [
        pytest.param(
            v,
            marks=extreme(f"splats of {v:g}", given="a patch of 9x9 under the disc", expected="81 excluded"),
        )
        for v in (np.nan, np.inf, 1e30)
    ],
)
def test_broken_splats_are_left_out(value, got):
    given = example(6, 4).parents
    splat = given.splat.copy()
    splat[30:39, 30:39] = value
    fused = fuse(replace(given, splat=splat))
    assert got(fused.excluded) == 81
    assert np.isfinite(fused.radiance).all()
    assert fused.radiance.max() < 10


def test_a_lamp_is_not_out_of_proportion():
    """Its pixels vouch for each other; the brightest things in scenes are suns of some 1e9."""
    given = example(6, 16).parents
    images = {name: getattr(given, name).copy() for name in ("traced", "denoised", "splat", "variance")}
    for name, image in images.items():
        image[20:24, 20:24] = 0 if name == "variance" else 1e9
    fused = fuse(replace(given, **images))
    assert fused.excluded == 0
    np.testing.assert_allclose(fused.radiance[21:23, 21:23], 1e9, rtol=0.01)
    assert np.isfinite(fused.radiance).all()


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6, 1e12, 1e18])
def test_trust_matches_float64_at_any_brightness(scale):
    given = example(6, 16).parents
    denoised, traced = (getattr(given, n) * np.float32(scale) for n in ("denoised", "traced"))
    variance = (given.variance * np.float64(scale) ** 2).astype(np.float32)
    images = {"traced": traced, "variance": variance, "count": given.count}
    np.testing.assert_allclose(trusted(denoised, **images), plain_fusion.trust(denoised, **images), atol=1e-5)


@extreme(
    "the trust in a sample of 1e15", given="64x64, one pixel", expected="a number everywhere, as float64"
)
def test_trust_holds_squares_of_squares(got):
    estimate, traced = np.ones((2, 64, 64, 3), np.float32)
    traced[20, 20] = 1e15
    variance = np.full_like(traced, 0.01)
    variance[20, 20] = 1e30
    images = {"traced": traced, "variance": variance, "count": np.full((64, 64, 1), 4, np.float32)}
    share = trusted(estimate, **images)
    assert got(int(np.isnan(share).sum())) == 0
    np.testing.assert_allclose(share, plain_fusion.trust(estimate, **images), atol=1e-5)


def test_the_share_of_a_flat_estimate_matches_a_plain_twin():
    """v / (v + b^2) with means over 6 x 6 pixels, in plain NumPy."""
    v, b = 0.01, 0.2
    plain = uniform_filter(np.full((8, 8), v), 3) / uniform_filter(np.full((8, 8), b**2), 3)
    flat = lambda value, channels=3: np.full((16, 16, channels), value, np.float32)  # noqa: E731
    share = trusted(flat(1), traced=flat(1 + b), variance=flat(v), count=flat(64, 1))
    np.testing.assert_allclose(share[::2, ::2], plain, rtol=1e-4)
