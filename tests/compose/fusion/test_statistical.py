"""Fusion by statistics alone: its formulas, and what they lead to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from compose.fusion import combination as module
from compose.fusion.combination import statistical
from compose.fusion.parents import Parents, as_batch
from tests.compose.fusion.examples import blurred, error, example, radiance_of

Array = NDArray[np.float64]


def fused(parents: Parents) -> tuple[Array, Array]:
    """Radiance and weights (H, W, 3)."""
    names = "traced", "denoised", "splat", "albedo", "count"
    found = statistical(*(as_batch(getattr(parents, name)) for name in names), parents.quick)
    return tuple(image[0].permute(1, 2, 0).double().numpy() for image in found)


def interpolated(coarse: Array, height: int, width: int) -> Array:
    """(H, W) from a quarter of the resolution, between the centres of pixels."""
    for axis, side in enumerate((height, width)):
        at = (np.arange(side) + 0.5) / 4 - 0.5
        one = lambda values, at=at: np.interp(at, np.arange(len(values)), values)  # noqa: E731
        coarse = np.apply_along_axis(one, axis, coarse)
    return coarse


def twin(parents: Parents) -> tuple[Array, Array]:
    """What `fused` computes."""
    traced, denoised, splat, albedo = (
        np.asarray(getattr(parents, name), np.float64) for name in ("traced", "denoised", "splat", "albedo")
    )
    level = ((denoised + splat) / 2).mean(2, keepdims=True)
    level = level + 0.1 * level.mean()
    seen = lambda image: image / (image + level)  # noqa: E731
    texture = np.log(albedo + 0.03) - np.log(uniform_filter(albedo, (3, 3, 1), mode="nearest") + 0.03)
    change = seen(splat) * (1 - seen(splat)) * texture
    change[(traced == splat).all(2)] = 0
    lacks = [(change * (seen(image) - seen(splat))).sum() / (change**2).sum() for image in (traced, denoised)]
    splat = splat * np.exp(0.7 * np.clip(min(lacks), -1, 1) * texture)
    way = seen(denoised) - seen(splat)
    maps = (seen(traced) - seen(denoised)) ** 2, way**2, (seen(traced) - seen(splat)) * way
    height, width = level.shape[:2]
    blocks = [m.mean(2).reshape(height // 4, 4, width // 4, 4).mean((1, 3)) for m in maps]
    removed, apart, along = (uniform_filter(block, 3, mode="nearest") for block in blocks)
    by = module.ODDS
    odds = by["even"] + by["removed"] * np.log(removed + 1e-5) + by["apart"] * np.log(apart + 1e-5)
    odds = odds + by["along"] * np.clip(along / (apart + 1e-5), -3, 3)
    odds = odds + (by["quick"] if parents.quick else by["doublings"] * np.log2(parents.count.mean()))
    share = interpolated(1 / (1 + np.exp(-odds)), height, width)[..., None]
    weights = np.concatenate([0 * share, share, 1 - share], 2)
    return share * denoised + (1 - share) * splat, weights


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("spp", [1, 8])
def test_radiance_and_weights_are_those_of_the_formulas(spp, quick):
    parents = replace(example(3, spp).parents, quick=quick)
    # As around a disc, where nothing was traced.
    parents.traced[:20] = parents.splat[:20]
    for found, expected in zip(fused(parents), twin(parents), strict=True):
        np.testing.assert_allclose(found, expected, atol=2e-4)


@pytest.mark.parametrize("exponent", [-60, -20, 20, 60])
def test_radiance_has_no_unit(exponent):
    parents = example(4, 2).parents
    names = "traced", "denoised", "splat"
    scaled = replace(parents, **{name: np.ldexp(getattr(parents, name), exponent) for name in names})
    (one, weights), (other, same) = fused(parents), fused(scaled)
    np.testing.assert_allclose(np.ldexp(other, -exponent), one, rtol=1e-4)
    np.testing.assert_allclose(same, weights, atol=1e-4)


def test_black_images_stay_black():
    parents = example(4, 2).parents
    black = {name: np.zeros_like(parents.traced) for name in ("traced", "denoised", "splat")}
    radiance, weights = fused(replace(parents, **black))
    assert (radiance == 0).all()
    np.testing.assert_allclose(weights.sum(2), 1, atol=1e-6)


@pytest.mark.parametrize("spp", [1, 4, 16, 64])
def test_the_result_is_no_worse_than_denoised_samples_and_splats(spp):
    given = example(8, spp)
    better = min(error(getattr(given.parents, name), radiance_of(given)) for name in ("denoised", "splat"))
    assert error(fused(given.parents)[0], radiance_of(given)) < better + 0.05


def test_the_error_falls_with_the_samples():
    errors = [
        error(fused(example(9, spp).parents)[0], radiance_of(example(9, spp))) for spp in (1, 4, 16, 64)
    ]
    assert errors == sorted(errors, reverse=True)


def test_samples_with_more_noise_give_denoising_less_weight():
    given = example(5, 4).parents
    signs = np.indices(given.count.shape).sum(0) % 2 * 2 - 1
    one, other = (replace(given, traced=given.denoised * (1 + noise * signs)) for noise in (0.2, 0.8))
    assert fused(other)[1][..., 1].mean() < fused(one)[1][..., 1].mean() - 0.1


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


def test_splats_get_no_more_texture_than_samples_and_denoising_agree_on():
    """Denoising that copies noise of the albedo sees texture where the samples do not."""
    truth, albedo = flat_wall()
    plain = np.full_like(truth, 0.7) + np.linspace(0, 0.1, 64, dtype=np.float32)[:, None, None]
    given = replace(
        example(1, 4, 64).parents, traced=plain, denoised=truth, splat=plain - 0.01, albedo=albedo
    )
    np.testing.assert_allclose(sharp(given), plain - 0.01, rtol=0.02)


def sharp(parents: Parents) -> Array:
    """The sharpened splats (H, W, 3)."""
    traced, denoised, splat, albedo = (
        as_batch(getattr(parents, name)) for name in ("traced", "denoised", "splat", "albedo")
    )
    level = ((denoised + splat) / 2).mean(1, keepdim=True)
    texture = module.texture_of(albedo)
    found = module.sharpened(splat, texture, (traced, denoised), level)
    assert torch.isfinite(found).all()
    return found[0].permute(1, 2, 0).numpy()
