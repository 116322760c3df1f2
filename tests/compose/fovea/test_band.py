"""Samples in the band, in proportion to the weight that they are shown with."""

from __future__ import annotations

import numpy as np
import pytest

from compose.blend.blend import blend
from compose.eye.gaze import Gaze
from compose.fovea.band import thinned
from compose.fovea.region import Foveation

SEEDS = 2000
PLAN = Foveation(Gaze(0.45, 0.6), 45, 20).region(64, 48)


def runs(spp: int, seeds: int = SEEDS):
    return (thinned(PLAN, spp, seed) for seed in range(seeds))


def from_the_mean(of: np.ndarray, expected: np.ndarray) -> float:
    """The furthest of (N, ...) independent values' means from what it should be, in standard errors."""
    error = of.std(axis=0, ddof=1) / np.sqrt(len(of))
    differs = np.abs(of.mean(axis=0) - expected)
    # What happens once in all the runs or less may not have happened yet.
    return float((differs / np.maximum(error, 1 / len(of))).max())


@pytest.mark.parametrize("spp", [1, 3])
def test_the_blend_is_that_of_the_whole_plan_on_the_mean(spp):
    rng = np.random.default_rng(0)
    splats = rng.uniform(size=(48, 64, 3)).astype(np.float32)
    traced = rng.uniform(size=(48 * 64, 3)).astype(np.float32)
    expected = blend(splats, traced[PLAN.pixels], PLAN)
    frames = np.stack([blend(splats, traced[region.pixels], region)[..., 0] for region, _ in runs(spp)])
    assert from_the_mean(frames, expected[..., 0]) < 5


@pytest.mark.parametrize("spp", [1, 2, 5])
def test_samples_follow_the_weights_on_the_mean(spp):
    counted = np.zeros((SEEDS, 48 * 64))
    for run, (region, counts) in enumerate(runs(spp)):
        counted[run, region.pixels] = counts
        assert counts.min() >= 1
    expected = spp * PLAN.weight_image().ravel()
    assert from_the_mean(counted, expected) < 5
    # Evenly over the picture, all of them together hardly depend on chance.
    assert np.abs(counted.sum(axis=1) - expected.sum()).max() < 0.04 * expected.sum()


@pytest.mark.parametrize("spp", [1, 4])
def test_no_pixel_of_the_band_is_noisier_than_the_disc(spp):
    """Samples of variance 1 around the splats' own radiance."""
    rng = np.random.default_rng(1)
    squares = np.zeros(48 * 64)
    for region, counts in runs(spp):
        noise = rng.normal(size=len(counts)) / np.sqrt(counts)
        squares[region.pixels] += (region.weights * noise) ** 2
    variance = squares / SEEDS
    band = (PLAN.weight_image() < 1).ravel()
    # Relative errors of variances from that many runs: sqrt(2 / SEEDS) and, with few samples, some more.
    assert variance[band].max() < 1.25 / spp
    expected = PLAN.weight_image().ravel() / spp
    assert variance.sum() == pytest.approx(expected.sum(), rel=0.02)


def test_inside_of_the_band_nothing_changes():
    region, counts = thinned(PLAN, 3, 0)
    inside = PLAN.pixels[PLAN.weights == 1]
    same = np.isin(region.pixels, inside)
    assert np.array_equal(region.pixels[same], inside)
    assert (region.weights[same] == 1).all()
    assert (counts[same] == 3).all()
    assert (np.diff(region.pixels.astype(np.int64)) > 0).all()


def test_a_disc_without_a_band_is_left_as_it_is():
    for foveation in (Foveation(Gaze(), 30, 30), Foveation(Gaze(), 500, 10), Foveation(Gaze(), 0, 0)):
        whole = foveation.region(40, 30)
        region, counts = thinned(whole, 2, 0)
        assert region is whole
        assert (counts == 2).all()


def test_the_seed_decides():
    one, again, other = (thinned(PLAN, 1, seed)[0].pixels for seed in (3, 3, 4))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
