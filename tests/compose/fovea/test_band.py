"""Samples in the band, in proportion to their weight in the blend."""

from __future__ import annotations

import numpy as np
import pytest

from compose.blend.blend import blend
from compose.eye.gaze import Gaze
from compose.fovea.band import thinned
from compose.fovea.region import FoveaRegion, Foveation

SEEDS = 2000
REGION = Foveation(Gaze(0.45, 0.6), 45, 20).region(64, 48)


def runs(spp: int, seeds: int = SEEDS):
    return (thinned(REGION, spp, seed) for seed in range(seeds))


def from_the_mean(of: np.ndarray, expected: np.ndarray) -> float:
    """Largest error of the means of (N, ...) independent values, in standard errors."""
    error = of.std(axis=0, ddof=1) / np.sqrt(len(of))
    differs = np.abs(of.mean(axis=0) - expected)
    # An event of that probability may not have happened in any run.
    return float((differs / np.maximum(error, 1 / len(of))).max())


@pytest.mark.parametrize("spp", [1, 3])
def test_the_blend_is_unbiased(spp):
    rng = np.random.default_rng(0)
    splats = rng.uniform(size=(48, 64, 3)).astype(np.float32)
    traced = rng.uniform(size=(48 * 64, 3)).astype(np.float32)
    expected = blend(splats, traced[REGION.pixels], REGION)
    frames = np.stack([blend(splats, traced[region.pixels], region)[..., 0] for region, _ in runs(spp)])
    assert from_the_mean(frames, expected[..., 0]) < 5


@pytest.mark.parametrize("spp", [1, 2, 5])
def test_sample_counts_follow_the_weights_on_average(spp):
    counted = np.zeros((SEEDS, 48 * 64))
    for run, (region, counts) in enumerate(runs(spp)):
        counted[run, region.pixels] = counts
        assert counts.min() >= 1
    expected = spp * REGION.weight_image().ravel()
    assert from_the_mean(counted, expected) < 5
    # Rounding is even over the image, so their sum hardly depends on chance.
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
    band = (REGION.weight_image() < 1).ravel()
    # Relative errors of variances from that many runs: sqrt(2 / SEEDS) and, with few samples, some more.
    assert variance[band].max() < 1.25 / spp
    expected = REGION.weight_image().ravel() / spp
    assert variance.sum() == pytest.approx(expected.sum(), rel=0.02)


def test_inside_the_band_nothing_changes():
    region, counts = thinned(REGION, 3, 0)
    inside = REGION.pixels[REGION.weights == 1]
    same = np.isin(region.pixels, inside)
    assert np.array_equal(region.pixels[same], inside)
    assert (region.weights[same] == 1).all()
    assert (counts[same] == 3).all()
    assert (np.diff(region.pixels.astype(np.int64)) > 0).all()


def test_pixels_due_less_than_one_sample_keep_a_weight_of_one_sample():
    region, counts = thinned(REGION, 4, 0)
    assert region.weights.min() == 0.25
    original = dict(zip(REGION.pixels.tolist(), REGION.weights.tolist(), strict=True))
    before = np.array([original[pixel] for pixel in region.pixels.tolist()])
    np.testing.assert_allclose(region.weights, np.maximum(before, 0.25))
    # Each count is the whole number below or above what the pixel is due.
    assert (np.abs(counts - 4 * before) < 1).all()


def test_neighbouring_pixels_of_equal_weight_share_the_samples_evenly():
    """At half a sample per pixel no 4 x 4 pixels get fewer than 6 or more than 10 of 16."""
    flat = FoveaRegion(64, 64, np.arange(4000, dtype=np.uint32), np.full(4000, 0.5, np.float32), (0, 0), 0)
    for seed in range(5):
        found = np.zeros(64 * 64)
        region, counts = thinned(flat, 1, seed)
        found[region.pixels] = counts
        blocks = found.reshape(16, 4, 16, 4).sum(axis=(1, 3))[:15]
        assert blocks.min() >= 6
        assert blocks.max() <= 10


def test_a_disc_without_a_band_is_left_as_it_is():
    for foveation in (Foveation(Gaze(), 30, 30), Foveation(Gaze(), 500, 10), Foveation(Gaze(), 0, 0)):
        whole = foveation.region(40, 30)
        region, counts = thinned(whole, 2, 0)
        assert region is whole
        assert (counts == 2).all()


def test_the_seed_decides_the_rounding():
    one, again, other = (thinned(REGION, 1, seed)[0].pixels for seed in (3, 3, 4))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
