"""What the fusion estimates without drawing it to the samples: its formulas, and what they lead to."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
from numpy.typing import NDArray

from compose.fusion.combination import Fusion
from tests.compose.fusion import plain_fusion
from tests.compose.fusion.examples import (
    PlainParents,
    blurred,
    cropped,
    error,
    estimate,
    everywhere,
    example,
    fuse,
    image_of,
    smooth,
)

Array = NDArray[np.float64]


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("spp", [1, 8])
@pytest.mark.parametrize("size", [(96, 96), (72, 45), (33, 95), (5, 3), (1, 1)])
def test_radiance_is_that_of_the_formulas(size, spp, quick):
    parents = cropped(example(3, spp).parents, *size)
    parents = replace(parents, denoised=None, expected=0.002) if quick else parents
    parents.earlier[:] = spp / 4
    # As around a disc, where nothing was traced.
    parents.traced[:20] = parents.splat[:20]
    np.testing.assert_allclose(estimate(parents), plain_fusion.estimate(parents), atol=5e-5)


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("exponent", [-60, -20, 20, 60])
def test_radiance_has_no_unit(exponent, quick):
    parents = example(4, 2).parents
    parents = replace(parents, denoised=None) if quick else parents
    names = [name for name in ("traced", "denoised", "splat") if name in parents.images()]
    scaled = replace(parents, **{name: np.ldexp(getattr(parents, name), exponent) for name in names})
    np.testing.assert_allclose(np.ldexp(estimate(scaled), -exponent), estimate(parents), rtol=1e-3)


def test_black_images_stay_black():
    parents = example(4, 2).parents
    black = {name: np.zeros_like(parents.traced) for name in ("traced", "denoised", "splat")}
    assert (estimate(replace(parents, **black)) == 0).all()


@pytest.mark.parametrize(
    ("quick", "spp", "worse"),
    [
        *[(True, spp, -4) for spp in (1, 4, 16, 64)],
        *[(False, 1, -4), (False, 4, -3), (False, 16, -0.5)],
        # Denoised samples alone would be better here, where the splats are wrong by 16 dB more.
        (False, 64, 1.9),
    ],
)
def test_the_result_is_hardly_worse_than_its_better_parent(quick, spp, worse):
    given = example(8, spp)
    parents = replace(given.parents, denoised=None) if quick else given.parents
    names = ("splat",) if quick else ("splat", "denoised")
    better = min(error(getattr(parents, name), given.radiance) for name in names)
    assert error(fuse(parents).radiance, given.radiance) < better + worse


def test_the_error_falls_with_the_samples():
    errors = []
    for spp in (1, 4, 16, 64):
        given = example(9, spp)
        errors.append(error(fuse(given.parents).radiance, given.radiance))
    assert errors == sorted(errors, reverse=True)


def share_of_denoised(parents: PlainParents) -> float:
    """Mean weight of denoised samples in the estimate."""
    weights = fuse(parents).weights
    return float((weights[..., 1] / np.maximum(1 - weights[..., 0], 1e-6)).mean())


def test_samples_with_more_noise_give_denoising_less_weight():
    given = example(5, 4).parents
    signs = np.indices(given.count.shape).sum(0) % 2 * 2 - 1
    one, other = (replace(given, traced=given.denoised * (1 + noise * signs)) for noise in (0.2, 0.8))
    assert share_of_denoised(other) < share_of_denoised(one) - 0.1


def test_the_worse_the_splats_are_expected_to_be_the_more_the_samples_count():
    given = replace(example(5, 1).parents, denoised=None)
    weights = [fuse(replace(given, expected=expected)).weights[..., 3].mean() for expected in (0, 1e-4, 1)]
    assert weights == sorted(weights, reverse=True)
    assert weights[0] > weights[2] + 0.2


def test_denoising_samples_of_earlier_views_counts_less():
    given = example(5, 4).parents
    walked = replace(given, earlier=0.9 * given.count)
    assert share_of_denoised(walked) < share_of_denoised(given)


def test_splats_are_relit_where_light_has_changed():
    """A shadow that the splats lack: half of the light, over a part of the wall."""
    given = example(6, 4, 96)
    light = np.ones((96, 96, 1), np.float32)
    light[24:72, 24:72] = 0.5
    quick = replace(given.parents, traced=given.parents.traced * light, denoised=None)
    inside = np.s_[36:60, 36:60]
    truth = (given.radiance * light)[inside]
    assert error(estimate(quick)[inside], truth) < error(quick.splat[inside], truth) - 6


def flat_wall() -> tuple[Array, Array]:
    """(64, 64, 3) radiance and albedo of a wall in even light, textured finely."""
    albedo = np.kron(np.random.default_rng(1).uniform(0.2, 0.8, (32, 32, 3)), np.ones((2, 2, 1)))
    return (1.5 * albedo).astype(np.float32), albedo.astype(np.float32)


def test_splats_get_the_texture_that_they_lack():
    truth, albedo = flat_wall()
    splat = blurred(truth, 1)
    given = replace(example(1, 4, 64).parents, traced=truth, denoised=truth, splat=splat, albedo=albedo)
    assert error(sharp(given), truth) < error(splat, truth) - 4


def test_splats_that_have_all_texture_stay_as_they_are():
    truth, albedo = flat_wall()
    light = truth * np.linspace(0.9, 1.1, 64, dtype=np.float32)[:, None, None]
    given = replace(example(1, 4, 64).parents, traced=light, denoised=light, splat=truth, albedo=albedo)
    np.testing.assert_allclose(sharp(given), truth, rtol=0.02)


def sharp(parents: PlainParents) -> Array:
    """The sharpened splats (H, W, 3)."""
    fusion = Fusion(parents.on_device())
    (found, *_), _ = fusion.candidates(smooth(fusion.ratio))
    image = image_of(parents, [dr.gather(type(of), of, everywhere(parents)) for of in found])
    assert np.isfinite(image).all()
    return image
