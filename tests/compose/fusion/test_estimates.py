"""What the fusion estimates without drawing it to the samples: its formulas, and what they lead to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from compose.fusion import estimates as module
from compose.fusion.parents import Parents, as_batch
from tests.compose.fusion.examples import IMAGES, blurred, error, estimate, example, fuse, smooth

Array = NDArray[np.float64]


def interpolated(coarse: Array, height: int, width: int) -> Array:
    """(height, width, C) of a coarser image, between the centres of pixels."""
    for axis, side in enumerate((height, width)):
        at = (np.arange(side) + 0.5) * coarse.shape[axis] / side - 0.5
        one = lambda values, at=at: np.interp(at, np.arange(len(values)), values)  # noqa: E731
        coarse = np.apply_along_axis(one, axis, coarse)
    return coarse


def blocks(image: Array, side: int) -> Array:
    height, width, channels = image.shape
    return image.reshape(height // side, side, width // side, side, channels).mean((1, 3))


def twin(parents: Parents) -> Array:
    """What `estimate` computes, (H, W, 3)."""
    given = {name: np.asarray(image, np.float64) for name, image in parents.images().items()}
    traced, splat, albedo = given["traced"], given["splat"], given["albedo"]
    dark = 0.1 * np.sqrt((traced + splat) / 2).mean() ** 2
    level = splat.mean(2, keepdims=True) + dark
    seen = lambda image: image / (image + level)  # noqa: E731
    texture = np.log(albedo + 0.03) - np.log(uniform_filter(albedo, (3, 3, 1), mode="nearest") + 0.03)
    change = seen(splat) * (1 - seen(splat)) * texture
    change[(traced == splat).all(2)] = 0
    lacks = (change * (seen(traced) - seen(splat))).sum() / (change**2).sum()
    splat = splat * np.exp(np.clip(lacks - 0.25, 0, 1) * texture)
    ratio = (blocks(traced, 2) + dark / 2) / (blocks(splat, 2) + dark / 2)
    for _ in range(4):
        ratio = uniform_filter(np.minimum(ratio, 100), (3, 3, 1), mode="nearest")
    relit = interpolated(ratio, *traced.shape[:2]) * (splat + dark / 2) - dark / 2
    estimates = [splat, relit, *([given["denoised"]] if "denoised" in given else [])]

    def pair(one: Array, other: Array) -> list[Array]:
        way = seen(other) - seen(one)
        maps = (seen(traced) - seen(other)) ** 2, way**2, (seen(traced) - seen(one)) * way
        lacks, apart, along = (
            uniform_filter(blocks(m.mean(2, keepdims=True), 4), (3, 3, 1), mode="nearest") for m in maps
        )
        return [np.log(lacks + 1e-5), np.log(apart + 1e-5), np.clip(along / (apart + 1e-5), -3, 3)]

    channels = pair(splat, relit)
    even = np.ones_like(channels[0])
    channels = [even, *channels]
    if "denoised" in given:
        lacks, apart, along = pair(splat, given["denoised"])
        along = (along - 0.5) * np.log2(parents.count.mean())
        channels += [lacks, apart, along, *pair(relit, given["denoised"])[1:]]
        channels.append(even * parents.earlier.mean() / parents.count.mean())
    else:
        channels.append(even * np.log(parents.expected))
    odds = module.ODDS if "denoised" in given else module.QUICK_ODDS
    logits = [0 * channels[0]] + [sum(o * c for o, c in zip(of, channels, strict=True)) for of in odds]
    weights = np.exp(logits) / np.exp(logits).sum(0)
    return sum(interpolated(w, *traced.shape[:2]) * e for w, e in zip(weights, estimates, strict=True))


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("spp", [1, 8])
def test_radiance_is_that_of_the_formulas(spp, quick):
    parents = example(3, spp).parents
    parents = replace(parents, denoised=None, expected=0.002) if quick else parents
    parents.earlier[:] = spp / 4
    # As around a disc, where nothing was traced.
    parents.traced[:20] = parents.splat[:20]
    np.testing.assert_allclose(estimate(parents), twin(parents), atol=5e-4)


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


def shares_of(parents: Parents) -> NDArray[np.float32]:
    """(H, W, 3) weights of splats, relit splats and denoised samples."""
    images = {name: as_batch(getattr(parents, name)) for name in IMAGES}
    traced, splat = images["traced"], images["splat"]
    dark = module.dark_of(traced, splat)
    light = module.relit(splat, smooth(module.ratio_of(traced, splat, dark)), dark)
    level = splat.mean(1, keepdim=True) + dark
    candidates = [splat, light, images["denoised"]]
    found = module.shares(module.evidence(candidates, images, level, parents.expected), splat)
    np.testing.assert_allclose(found.sum(1), 1, atol=1e-5)
    return found[0].permute(1, 2, 0).numpy()


def test_samples_with_more_noise_give_denoising_less_weight():
    given = example(5, 4).parents
    signs = np.indices(given.count.shape).sum(0) % 2 * 2 - 1
    one, other = (replace(given, traced=given.denoised * (1 + noise * signs)) for noise in (0.2, 0.8))
    assert shares_of(other)[..., 2].mean() < shares_of(one)[..., 2].mean() - 0.1


def test_the_worse_the_splats_are_expected_to_be_the_more_the_samples_count():
    given = replace(example(5, 1).parents, denoised=None)
    weights = [fuse(replace(given, expected=expected)).weights[..., 3].mean() for expected in (0, 1e-4, 1)]
    assert weights == sorted(weights, reverse=True)
    assert weights[0] > weights[2] + 0.2


def test_denoising_samples_of_earlier_views_counts_less():
    given = example(5, 4).parents
    walked = replace(given, earlier=0.9 * given.count)
    assert shares_of(walked)[..., 2].mean() < shares_of(given)[..., 2].mean()


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


def sharp(parents: Parents) -> Array:
    """The sharpened splats (H, W, 3)."""
    traced, splat, albedo = (as_batch(getattr(parents, name)) for name in ("traced", "splat", "albedo"))
    level = splat.mean(1, keepdim=True)
    found = module.sharpened(splat, module.texture_of(albedo), traced, level)
    assert torch.isfinite(found).all()
    return found[0].permute(1, 2, 0).numpy()
