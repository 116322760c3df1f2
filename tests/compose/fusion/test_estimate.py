"""The network's estimate: which parent it weighs, and what of each image reaches the network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from compose.fusion.features import Features
from compose.fusion.network import Fusion, estimated
from compose.fusion.parents import PARENTS, Parents, as_batch
from tests.compose.fusion.examples import cropped, example, random_fusion

IMAGES = ("traced", "denoised", "splat", "albedo", "normal", "count")


def view(seed: int = 1, **changes: float) -> Parents:
    """Images of 24 x 32 pixels."""
    return replace(cropped(example(seed, 4).parents, 24, 32), **changes)


def run(fusion: Fusion, *parents: Parents) -> tuple[Tensor, Tensor]:
    """Estimate and weights of a batch of images."""
    images = {n: torch.cat([as_batch(getattr(one, n)).float() for one in parents]) for n in IMAGES}
    with torch.inference_mode():
        return estimated(fusion, images, parents)


class Watched(Fusion):
    """Keeps what it saw."""

    def forward(self, features: Features) -> Tensor:
        self.seen = features
        return super().forward(features)


def test_parents_that_are_equal_give_their_radiance_as_long_as_nothing_is_fitted():
    given = view()
    agreed = replace(given, traced=given.splat, denoised=given.splat)
    radiance, weights = run(Fusion(), agreed)
    assert radiance.shape == weights.shape == (1, 3, 24, 32)
    np.testing.assert_allclose(radiance, as_batch(given.splat), rtol=1e-5)


@pytest.mark.parametrize("number", range(3))
def test_the_parent_that_a_network_asks_for_is_shown(number):
    given, fusion = view(), Fusion()
    # All four pixels of a block.
    fusion.judge.bias.data[4 * number : 4 * number + 4] = 60
    radiance, weights = run(fusion, given)
    np.testing.assert_allclose(radiance, as_batch(getattr(given, PARENTS[number])), rtol=1e-5)
    np.testing.assert_allclose(weights[0].mean((1, 2)), np.eye(3)[number], atol=1e-6)


def test_weights_are_shares_and_splats_are_sharpened_within_limits():
    given, fusion = view(), random_fusion()
    radiance, weights = run(fusion, given)
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-6)
    assert weights.min() >= 0
    # Without the samples, what is left are the splats' share and their sharpening.
    dark = 0 * given.traced
    radiance, weights = run(fusion, replace(given, traced=dark, denoised=dark))
    factor = radiance / (weights[:, 2:3] * as_batch(given.splat))
    assert 1.2 < factor.max() <= np.exp(2) * 1.001
    assert np.exp(-2) * 0.999 <= factor.min() < 0.8


def test_texture_in_the_albedo_sharpens_the_splats():
    """Where the albedo is above its mean, texture brightens; elsewhere it darkens."""
    given, fusion = view(), Fusion()
    fusion.judge.bias.data[8:12] = 60  # the splats alone
    fusion.judge.bias.data[12:16] = 1  # as much texture as in windows of 3 pixels
    albedo = np.full((24, 32, 3), 0.3, np.float32)
    albedo[:, 16:] = 0.6
    radiance, _ = run(fusion, replace(given, albedo=albedo))
    factor = (radiance / as_batch(given.splat)).numpy()
    # Windows of 3 x 3 have one column of the other side: a mean of 0.4 and 0.5, and 0.03 added to all.
    np.testing.assert_allclose(factor[..., 15], 0.33 / 0.43, rtol=1e-4)
    np.testing.assert_allclose(factor[..., 16], 0.63 / 0.53, rtol=1e-4)
    np.testing.assert_allclose(factor[..., :15], 1, rtol=1e-4)


def test_each_image_of_a_batch_is_seen_with_its_own_enlargement_and_denoiser():
    fusion = Watched()
    run(fusion, view(enlargement=4.0, quick=True), view(enlargement=0.5), view(enlargement=1.0, quick=True))
    coarse = Features.COARSE.parts(fusion.seen.coarse)
    for name, expected in (("enlargement", (2, -1, 0)), ("quick", (1, 0, 1))):
        values = np.broadcast_to(np.array(expected).reshape(3, 1, 1, 1), (3, 1, 12, 16))
        np.testing.assert_allclose(coarse[name], values)


def test_albedo_normal_count_and_radiance_are_seen_where_they_belong():
    values = {"albedo": 0.25, "normal": -0.5, "count": 16.0, "traced": 4.0, "denoised": 1.0, "splat": 0.0}
    given = view()
    images = {name: np.full_like(getattr(given, name), value) for name, value in values.items()}
    fusion = Watched()
    run(fusion, replace(given, **images))
    coarse, fine = Features.COARSE.parts(fusion.seen.coarse), Features.FINE.parts(fusion.seen.fine)
    np.testing.assert_allclose(coarse["albedo"], 0.25, rtol=1e-6)
    np.testing.assert_allclose(coarse["normal"], -0.5, rtol=1e-6)
    # A third of the logarithm to base 2, less 1.
    np.testing.assert_allclose(coarse["count"], 1 / 3, rtol=1e-5)
    # Roughly the square root: 0 of 0 and 1 of 1; twice the fourth root, less 1, beyond: 1.83 of 4.
    np.testing.assert_allclose(fine["splat"], 0, atol=0.04)
    np.testing.assert_allclose(fine["difference"], 1, atol=0.04)
    np.testing.assert_allclose(fine["residual"], 0.828, atol=1e-3)


@pytest.mark.parametrize("name", [*IMAGES, "enlargement", "quick"])
def test_a_fitted_network_judges_by_everything_it_is_given(name):
    given = view()
    other = view(seed=2, enlargement=3.0, quick=True)
    changed = getattr(other, name) * 4 if name == "count" else getattr(other, name)
    if name == "normal":
        changed = given.normal[..., ::-1].copy()
    weights, after = (run(random_fusion(), one)[1] for one in (given, replace(given, **{name: changed})))
    assert (weights - after).abs().max() > 1e-4


def test_a_batch_is_estimated_like_its_images_alone():
    fusion = random_fusion()
    views = [view(1), view(2, enlargement=4.0, quick=True), view(3, enlargement=1.0)]
    together = run(fusion, *views)
    for number, one in enumerate(views):
        for joint, alone in zip(together, run(fusion, one), strict=True):
            np.testing.assert_allclose(joint[number], alone[0], rtol=1e-4, atol=1e-5)
