"""Samples in the band, in proportion to their weight in the blend."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from compose.base.arrays import Arrays
from compose.base.traced_samples import Counts
from compose.eye.gaze import Gaze
from compose.fovea.disc import Disc, blend, thinned
from compose.fovea.foveation import Foveation
from tests.compose.arrays_of import channels, disc_of, each_of, image_on

SEEDS = 2000
REGION = Foveation(Gaze(0.45, 0.6), 45, 20).region(64, 48)


@pytest.fixture(scope="module")
def whole(arrays) -> Disc:
    """The disc that is thinned."""
    return REGION.disc(arrays)


def runs(whole: Disc, spp: int, seeds: int = SEEDS) -> Iterator[tuple[Disc, np.ndarray]]:
    return (thin(whole, spp, seed) for seed in range(seeds))


def thin(whole: Disc, spp: int, seed: int) -> tuple[Disc, np.ndarray]:
    """The thinned disc, and (D,) samples of each of its pixels."""
    disc, counts = thinned(whole, spp, seed)
    return disc, each_of(counts, disc.count)


def from_the_mean(of: np.ndarray, expected: np.ndarray) -> float:
    """Largest error of the means of (N, ...) independent values, in standard errors."""
    error = of.std(axis=0, ddof=1) / np.sqrt(len(of))
    differs = np.abs(of.mean(axis=0) - expected)
    # An event of that probability may not have happened in any run.
    return float((differs / np.maximum(error, 1 / len(of))).max())


def plainly_thinned(whole: Disc, spp: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels, weights and counts (D,), in plain NumPy."""
    pixels, weights = np.array(whole.pixels), np.array(whole.weights)
    counts = np.full(len(pixels), spp, dtype=np.int64)
    band = np.flatnonzero(weights < 1)
    row, column = np.divmod(pixels[band], np.uint32(whole.width))
    start = np.uint32(np.random.SeedSequence(seed).generate_state(1)[0])
    mask = (column * np.uint32(3242174889) + row * np.uint32(2447445414) + start).astype(np.float64) / 2**32
    counts[band] = np.floor(spp * weights[band].astype(np.float64) + mask).astype(np.int64)
    kept = counts > 0
    return pixels[kept], np.maximum(weights[kept], np.float32(1 / spp)), counts[kept]


@pytest.mark.parametrize("spp", [1, 2, 3, 64, 16384])
@pytest.mark.parametrize("seed", [0, 5, 2**63 - 1])
def test_thinned_discs_match_a_plain_twin(whole, spp, seed):
    disc, counts = thin(whole, spp, seed)
    pixels, weights, expected = plainly_thinned(whole, spp, seed)
    np.testing.assert_array_equal(disc.pixels, pixels)
    np.testing.assert_allclose(disc.weights, weights, rtol=1e-6)
    np.testing.assert_array_equal(counts, expected)
    assert (disc.width, disc.height, disc.box) == (whole.width, whole.height, whole.box)


@pytest.mark.parametrize("spp", [1, 3])
def test_the_blend_is_unbiased(arrays, whole, spp):
    rng = np.random.default_rng(0)
    splats = image_on(arrays, rng.uniform(size=(48, 64, 3)).astype(np.float32))
    traced = rng.uniform(size=(48 * 64, 3)).astype(np.float32)

    def blended(disc: Disc) -> np.ndarray:
        fovea = channels(arrays, traced[np.array(disc.pixels)])
        return blend(splats.packed(), fovea, disc)[0].numpy()[..., 0].copy()

    frames = np.stack([blended(disc) for disc, _ in runs(whole, spp)])
    assert from_the_mean(frames, blended(whole)) < 5


@pytest.mark.parametrize("spp", [1, 2, 5])
def test_sample_counts_follow_the_weights_on_average(whole, spp):
    counted = np.zeros((SEEDS, 48 * 64))
    for run, (disc, counts) in enumerate(runs(whole, spp)):
        counted[run, np.array(disc.pixels)] = counts
        assert counts.min() >= 1
    expected = spp * REGION.weight_image().ravel()
    assert from_the_mean(counted, expected) < 5
    # Rounding is even over the image, so their sum hardly depends on chance.
    assert np.abs(counted.sum(axis=1) - expected.sum()).max() < 0.04 * expected.sum()


@pytest.mark.parametrize("spp", [1, 4])
def test_no_pixel_of_the_band_is_noisier_than_the_disc(whole, spp):
    """Samples of variance 1 around the splats' own radiance."""
    rng = np.random.default_rng(1)
    squares = np.zeros(48 * 64)
    for disc, counts in runs(whole, spp):
        noise = rng.normal(size=len(counts)) / np.sqrt(counts)
        squares[np.array(disc.pixels)] += (np.array(disc.weights) * noise) ** 2
    variance = squares / SEEDS
    band = (REGION.weight_image() < 1).ravel()
    # Relative errors of variances from that many runs: sqrt(2 / SEEDS) and, with few samples, some more.
    assert variance[band].max() < 1.25 / spp
    expected = REGION.weight_image().ravel() / spp
    assert variance.sum() == pytest.approx(expected.sum(), rel=0.02)


def test_inside_the_band_nothing_changes(whole):
    disc, counts = thin(whole, 3, 0)
    pixels, weights = np.array(disc.pixels), np.array(disc.weights)
    inside = np.array(whole.pixels)[np.array(whole.weights) == 1]
    same = np.isin(pixels, inside)
    assert np.array_equal(pixels[same], inside)
    assert (weights[same] == 1).all()
    assert (counts[same] == 3).all()
    assert (np.diff(pixels.astype(np.int64)) > 0).all()


def test_pixels_due_less_than_one_sample_keep_a_weight_of_one_sample(whole):
    disc, counts = thin(whole, 4, 0)
    weights = np.array(disc.weights)
    assert weights.min() == 0.25
    original = dict(zip(np.array(whole.pixels).tolist(), np.array(whole.weights).tolist(), strict=True))
    before = np.array([original[pixel] for pixel in np.array(disc.pixels).tolist()])
    np.testing.assert_allclose(weights, np.maximum(before, 0.25))
    # Each count is the whole number below or above what the pixel is due.
    assert (np.abs(counts - 4 * before) < 1).all()


def flat(arrays: Arrays, size: int, weight: float) -> Disc:
    """The first pixels of 64 x 64, all of one weight."""
    return disc_of(arrays, 64, 64, np.arange(size, dtype=np.uint32), np.full(size, weight, np.float32))


def test_neighbouring_pixels_of_equal_weight_share_the_samples_evenly(arrays):
    """At half a sample per pixel no 4 x 4 pixels get fewer than 6 or more than 10 of 16."""
    for seed in range(5):
        found = np.zeros(64 * 64)
        disc, counts = thin(flat(arrays, 4000, 0.5), 1, seed)
        found[np.array(disc.pixels)] = counts
        blocks = found.reshape(16, 4, 16, 4).sum(axis=(1, 3))[:15]
        assert blocks.min() >= 6
        assert blocks.max() <= 10


def test_a_disc_without_a_band_keeps_all_its_samples(arrays):
    for foveation in (Foveation(Gaze(), 30, 30), Foveation(Gaze(), 500, 10), Foveation(Gaze(), 0, 0)):
        whole = foveation.region(40, 30).disc(arrays)
        disc, counts = thin(whole, 2, 0)
        np.testing.assert_array_equal(disc.pixels, whole.pixels)
        np.testing.assert_array_equal(disc.weights, whole.weights)
        assert (counts == 2).all()


def test_a_disc_that_covers_the_frame_or_is_empty_is_left_as_it_is(arrays):
    for foveation in (Foveation(Gaze(), 500, 10), Foveation(Gaze(), 0, 0)):
        whole = foveation.region(40, 30).disc(arrays)
        assert thinned(whole, 2, 0) == (whole, 2)


@pytest.mark.parametrize("size", [1, 9])
def test_a_disc_that_is_due_no_samples_becomes_empty(arrays, size):
    disc, counts = thin(flat(arrays, size, 1e-9), 1, 0)
    assert disc.count == 0
    assert disc.box is None
    assert len(counts) == 0


def test_one_sample_per_pixel_is_one_number_for_all(whole):
    assert thinned(whole, 1, 0)[1] == 1
    assert isinstance(thinned(whole, 2, 0)[1], Counts)


def test_the_seed_decides_the_rounding(whole):
    one, again, other = (np.array(thinned(whole, 1, seed)[0].pixels) for seed in (3, 3, 4))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
