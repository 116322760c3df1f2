"""Region, allotment, records and history at the ends of what users may ask for."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from compose.base.arrays import Arrays
from compose.eye.gaze import Gaze
from compose.fovea.disc import thinned
from compose.fovea.foveation import Foveation
from compose.fovea.history import History
from compose.fovea.samples import RECORD, limited, means, merged, with_light
from tests import small
from tests.compose.arrays_of import PlainSamples, channels, each_of, host, indices, numbers
from tests.compose.fovea.views import camera, samples, wall, whole
from tests.extremes import extreme

SIDES = st.sampled_from([(64, 48), (48, 64), (1, 90), (90, 1), (7, 5)])
GAZES = st.tuples(st.floats(-1, 2), st.floats(-1, 2))


def furthest_of(gaze: tuple[float, float], size: tuple[int, int]) -> float:
    """Distance in pixels of the furthest pixel of a frame of a size."""
    return float(np.hypot(*(max(at * n, n - at * n) - 0.5 for at, n in zip(gaze, size, strict=True))))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    size=SIDES,
    gaze=GAZES,
    radius=st.one_of(st.floats(1, 200), st.none()),
    share=st.floats(0, 0.9),
    step=st.floats(1e-3, 0.5),
)
def test_neighbouring_fov_a_give_neighbouring_weights(size, gaze, radius, share, step):
    """A weight changes by no more than the disc grows over the widths of the band and of the fading.

    No radius stands for the one at which the disc reaches the furthest pixel.
    """
    width, height = size
    furthest = furthest_of(gaze, size)
    fov_a = 100 * furthest / height - step / 2 if radius is None else radius
    one, other = (
        Foveation(Gaze(*gaze), radius, share * fov_a).region(width, height).weight_image()
        for radius in (fov_a, fov_a + step)
    )
    grown = step / 100 * height
    most = grown / ((1 - share) * fov_a / 100 * height) + grown / (0.2 * furthest)
    assert np.abs(one - other).max() <= most + 1e-4


@extreme(
    "fov-a past the corner",
    given="fov-a 75 to 110 % in steps of 0.1 %, fov-b 15 %, 640x480",
    expected="weights change by less than 0.01 a step",
)
def test_the_picture_does_not_pop_where_the_disc_begins_to_cover_the_frame(got):
    weights = (Foveation(Gaze(), a, 15).region(640, 480).weight_image() for a in np.arange(75, 110, 0.1))
    changes = [float(np.abs(one - other).max()) for one, other in pairwise(weights)]
    assert got(max(changes), ".4f") < 0.01


@settings(max_examples=40, deadline=None, derandomize=True)
@given(size=SIDES, gaze=GAZES, fov_a=st.floats(5, 200), share=st.floats(0, 0.9), way=st.floats(-1, 1))
def test_neighbouring_gazes_give_neighbouring_weights(size, gaze, fov_a, share, way):
    width, height = size
    step = 0.01 * way
    one, other = (
        Foveation(Gaze(x, gaze[1]), fov_a, share * fov_a).region(width, height).weight_image()
        for x in (gaze[0], gaze[0] + step)
    )
    moved = abs(step) * width
    fading = moved * (1 + 1.2) / (0.2 * max(furthest_of(gaze, size) - moved, 1e-9))
    assert np.abs(one - other).max() <= moved / ((1 - share) * fov_a / 100 * height) + fading + 1e-4


@pytest.mark.parametrize(
    ("fov_a", "fov_b", "expected"),
    [
        pytest.param(
            a, b, e, marks=extreme(name, given=f"fov-a {a:g} %, fov-b {b:g} %", expected=f"{e} weight in all")
        )
        for name, a, b, e in (
            ("no disc", 0.0, 0.0, 0),
            ("a disc of denormal radius", 5e-324, 5e-324, 0),
            ("a disc of a millionth", 1e-6, 0.0, 0),
            ("equal radii of 200 %", 200.0, 200.0, 64 * 48),
            ("fov-a of a million", 1e6, 15.0, 64 * 48),
            ("fov-a beyond float64", 1e308, 15.0, 64 * 48),
        )
    ],
)
def test_radii_at_their_ends(arrays, fov_a, fov_b, expected, got):
    region = Foveation(Gaze(), fov_a, fov_b).region(64, 48)
    assert got(float(region.weight_image().sum()), "g") == expected
    assert np.array(region.disc(arrays).weights).sum() == expected
    assert region.covers_frame == (expected == 64 * 48)


@pytest.mark.parametrize("band", [0.0, 1e-300, 1e-7, 1e-5])
def test_a_band_thinner_than_a_pixel_is_an_edge(arrays, band):
    region = Foveation(Gaze(), 25 + band, 25).region(64, 48)
    image, weights = region.weight_image(), np.array(region.disc(arrays).weights)
    assert np.isfinite(weights).all()
    np.testing.assert_array_equal(weights, 1)
    np.testing.assert_array_equal(image.ravel()[region.pixels], 1)
    assert image.sum() == len(weights) > 0


@pytest.mark.parametrize(
    "size",
    [
        pytest.param(
            size, marks=extreme(f"a frame of {size[0]}x{size[1]}", given="fov-a 20 %", expected="twin")
        )
        for size in ((1, 1), (1, 4096), (4096, 1), (4096, 4096))
    ],
)
@pytest.mark.parametrize("gaze", [(0.5, 0.5)])
def test_regions_of_extreme_frames(arrays, size, gaze, got):
    """Against float64, in the rows and columns through the middle where the frame is large."""
    width, height = size
    region = Foveation(Gaze(*gaze), 20, 15).region(width, height)
    weights = region.weight_image()
    y, x = np.arange(height)[:: max(1, height // 64)], np.arange(width)[:: max(1, width // 64)]
    radius = np.hypot(x[None] + 0.5 - gaze[0] * width, y[:, None] + 0.5 - gaze[1] * height)
    twin = np.clip((0.2 * height - radius) / (0.05 * height), 0, 1)
    assert got(float(np.abs(weights[np.ix_(y, x)] - twin).max()), ".1e") < 1e-5
    disc = region.disc(arrays)
    on_device = disc.frame_image([disc.weights])[..., 0]
    assert np.abs(on_device[np.ix_(y, x)] - twin).max() < 1e-5


@pytest.mark.parametrize(
    "gaze",
    [
        pytest.param(
            gaze, marks=extreme(f"gaze at {gaze[0]:g} {gaze[1]:g}", given="640x480", expected="twin")
        )
        for gaze in ((0, 0), (1, 0), (0, 1), (1, 1), (-900.0, 0.5))
    ],
)
def test_gazes_at_their_ends(arrays, gaze, got):
    """The disc reaches into the frame, however far away its middle is."""
    reach = np.hypot(gaze[0] * 640 - 320, gaze[1] * 480 - 240)
    a, b = reach + 100, reach - 100
    region = Foveation(Gaze(*gaze), a / 4.8, b / 4.8).region(640, 480)
    radius = np.hypot(
        np.arange(640)[None] + 0.5 - gaze[0] * 640, np.arange(480)[:, None] + 0.5 - gaze[1] * 480
    )
    twin = np.clip((a - radius) / (a - b), 0, 1)
    assert got(float(np.abs(region.weight_image() - twin).max()), ".1e") < 1e-3
    disc = region.disc(arrays)
    assert np.abs(disc.frame_image([disc.weights])[..., 0] - twin).max() < 1e-3


NAN = np.float32("nan")


@extreme(
    "NaN splats in the allotment", given="one NaN pixel of 64x64", expected="all samples go out, a few there"
)
def test_a_splat_that_is_not_a_number_does_not_decide_where_samples_go(allotted, disagreement, got):
    denoised = small.rng().random((64, 64, 3)).astype(np.float32)
    splat = denoised * np.float32(0.9)
    expected = disagreement(denoised, splat)
    splat[20, 30, 1] = NAN
    worth = disagreement(denoised, splat)
    assert np.isfinite(worth).all()
    beside = np.ones_like(worth, dtype=bool)
    beside[18:23, 28:33] = False
    np.testing.assert_allclose(worth[beside], expected[beside], rtol=1e-4)
    counts = allotted(worth.ravel(), np.full(64 * 64, 2, np.float32), 8 * 64 * 64, 0).reshape(64, 64)
    assert counts.sum() == 8 * 64 * 64
    assert got(int(counts.min())) >= 0
    assert counts[18:23, 28:33].mean() > counts.mean()


@extreme("splats that are all NaN", given="64x64, 4 spp", expected="samples spread evenly")
def test_splats_without_a_number_leave_samples_even(allotted, disagreement, got):
    worth = disagreement(np.ones((16, 16, 3), np.float32), np.full((16, 16, 3), NAN))
    assert (allotted(worth.ravel(), np.full(256, 2, np.float32), 512, 0) == 2).all()
    assert got(float(np.ptp(worth))) == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_pixels_of_unknown_worth_get_the_most(allotted, value):
    worth = np.ones(1000, np.float32)
    worth[7] = value
    counts = allotted(worth, np.zeros(1000, np.float32), 100_000, 0)
    assert counts.sum() == 100_000
    assert counts[7] == pytest.approx(500, abs=5)


@pytest.mark.parametrize("worth", [0.0, 1e-45, 1e-30, 1e30, 3e38])
def test_equal_worth_of_any_size_gives_equal_samples(allotted, worth):
    counts = allotted(np.full(1000, worth, np.float32), np.zeros(1000, np.float32), 4000, 0)
    assert (counts == 4).all()


@extreme("no samples to give", given="a total of 0", expected="0 for each")
def test_a_total_of_zero_gives_none(allotted, got):
    counts = allotted(np.array([1, 2], np.float32), np.array([1, 3], np.float32), 0, 0)
    assert got(counts.tolist()) == [0, 0]


def allotted_in_float64(worth, have, total):
    """What each pixel is due, by bisection in float64."""
    worth = np.clip(worth / worth.mean(), 0.15, 5).astype(np.float64)
    low, high = 0.0, 1e30
    for _ in range(300):
        level = 0.5 * (low + high)
        due = np.clip(worth * level - have, have < 1, 8 * total / len(have))
        low, high = (level, high) if due.sum() < total else (low, level)
    return due


@pytest.mark.parametrize("most", [1, 1e3, 16384])
def test_the_allotment_matches_float64(allotted, most):
    rng = small.rng()
    worth, have = rng.random(500).astype(np.float32), (most * rng.random(500)).astype(np.float32)
    total = 500 * int(max(most, 2))
    counts = allotted(worth, have, total, 0)
    assert np.abs(counts - allotted_in_float64(worth, have, total)).max() < 1.01 + 1e-4 * total / 500


@pytest.mark.parametrize("spp", [1, 16384])
def test_thinned_bands_keep_their_mean(arrays, spp):
    disc = Foveation(Gaze(), 40, 10).region(64, 48).disc(arrays)
    thin, found = thinned(disc, spp, 2**63 - 1)
    counts = each_of(found, thin.count)
    assert counts.min() >= 1
    assert counts.max() == spp
    assert counts.sum() == pytest.approx(spp * float(np.array(disc.weights).sum()), rel=0.05)
    assert np.array(thin.weights).min() >= np.float32(1 / spp)


LARGEST = float(np.finfo(np.float32).max)


def lit(radiance: np.ndarray, count: float = 1) -> PlainSamples:
    """Samples of the first pixels of a wall."""
    return samples(wall(camera())[: len(radiance)], radiance, count=count)


@pytest.mark.parametrize(
    "radiance",
    [
        pytest.param(
            r, marks=extreme(f"variance at radiance {r:g}", given="16 samples", expected="float64's")
        )
        for r in (1e-8, 1.0, 1e6, 1e15)
    ],
)
def test_the_variance_of_samples_matches_float64(arrays, radiance, got):
    values = radiance * small.rng().gamma(0.5, 2, (16, 300, 3))
    mean, squares = (v.mean(axis=0).astype(np.float32) for v in (values, values**2))
    found = numbers(replace(lit(mean, 16), squares=squares).on(arrays), "variance")
    twin = values.var(axis=0) / 15
    assert got(float(np.abs(found - twin).max() / twin.max()), ".1e") < 1e-6


@extreme("variance of a firefly of 1e30", given="squares beyond float32", expected="inf: unknown")
def test_the_variance_of_squares_beyond_float32_is_unknown(arrays, got):
    radiance = np.full((2, 3), 0.5, np.float32)
    radiance[1] = 1e30
    variance = numbers(lit(radiance, 4).on(arrays), "variance")
    assert np.isfinite(variance[0]).all()
    assert got(float(variance[1, 0])) == np.inf


def nothing(arrays: Arrays, size: int) -> list[Any]:
    """Records of pixels of which nothing is known."""
    return channels(arrays, np.zeros((size, RECORD)))


@pytest.mark.parametrize("radiance", [1e15, 1e30, LARGEST])
def test_a_firefly_stays_in_the_mean_of_records(arrays, radiance):
    """One among 100 samples of 0.5, and one more later; pixels beside it do not notice."""
    records = with_light(nothing(arrays, 2), lit(np.full((2, 3), 0.5)).on(arrays))
    bright = lit(np.array([[0.5] * 3, [radiance] * 3], np.float32))
    for new in (bright, lit(np.full((2, 3), 0.5), 98)):
        records = with_light(records, new.on(arrays))
    count, mean, squares, *_ = means(records)
    assert (np.array(count) == 100).all()
    mean = host(mean)
    np.testing.assert_allclose(mean[0], 0.5, rtol=1e-6)
    np.testing.assert_allclose(mean[1], radiance / 100, rtol=1e-6)
    assert not np.isnan(host(squares)).any()
    np.testing.assert_allclose(host(means(limited(records, 32))[1]), mean, rtol=1e-6)


@extreme("several samples of float32's maximum", given="3 in one record", expected="finite mean")
def test_sums_beyond_float32_stay_finite(arrays, got):
    records = nothing(arrays, 1)
    for _ in range(3):
        records = with_light(records, lit(np.full((1, 3), LARGEST)).on(arrays))
    assert got(float(host(means(records)[1]).max()), ".1e") == pytest.approx(LARGEST / 3, rel=1e-6)


@pytest.mark.parametrize("radiance", [1e30, LARGEST])
def test_merging_keeps_fireflies_finite(arrays, radiance):
    one, other = lit(np.full((4, 3), 0.5), 3), lit(np.full((4, 3), radiance, np.float32), 1)
    both = merged(one.on(arrays), other.on(arrays))
    np.testing.assert_allclose(numbers(both, "radiance"), radiance / 4, rtol=1e-6)
    assert not np.isnan(numbers(both, "squares")).any()
    assert (numbers(both, "variance") == np.inf).all()


@extreme("100,000 frames of one view", given="1 sample each, radiance 0.1", expected="mean within 0.1 %")
def test_long_accumulation_keeps_the_mean(arrays, got):
    """Float32 sums lose what is below their last digit; up to here that is less than anyone sees."""
    new = lit(np.full((1, 3), 0.1, np.float32)).on(arrays)
    start = arrays.plain.UInt(0), nothing(arrays, 1)
    add = lambda i, records: (i + 1, with_light(records, new))  # noqa: E731
    _, records = dr.while_loop(start, lambda i, records: i < 100_000, add, mode="symbolic")
    count, mean, *_ = means(records)
    assert np.array(count).tolist() == [100_000]
    assert got(float(abs(host(mean)[0, 0] / 0.1 - 1)), ".1e") < 1e-3


@extreme("history with a firefly", given="1e30 in one pixel, then a step aside", expected="one pixel, finite")
def test_a_firefly_in_a_history_stays_in_its_pixel(arrays, got):
    """It moves with the surface that it was seen on, and nothing around it changes."""
    plain, bright = np.full((48 * 48, 3), 0.5, np.float32), np.full((48 * 48, 3), 0.5, np.float32)
    bright[24 * 48 + 24] = 1e30
    here, there = camera(), camera(1 / 12)
    pixels = np.arange(48 * 48, dtype=np.uint32)
    recalled = []
    for radiance in (plain, bright):
        history = History(arrays)
        for view, light in ((here, radiance), (there, plain)):
            seen = (lit(light) if view is here else samples(wall(there), plain)).on(arrays)
            history.see(view, seen, 4, 0, whole(arrays, view))
            history.remember(seen)
        recalled.append(PlainSamples.of(history.recall(indices(arrays, pixels))))
    assert np.isfinite(recalled[1].radiance).all()
    changed = (recalled[0].radiance != recalled[1].radiance).any(axis=1)
    assert got(int(changed.sum())) == 1
    assert recalled[1].radiance.max() == pytest.approx(5e29, rel=1e-6)


@extreme("a camera that jumps", given="1e6 away, with a history", expected="nothing of the view before")
def test_a_jump_leaves_nothing_of_the_view_before(arrays, got):
    history = History(arrays)
    for view, light in ((camera(), 0.5), (camera(1e6), 2.0)):
        seen = samples(wall(view), np.full((48 * 48, 3), light, np.float32)).on(arrays)
        history.see(view, seen, 4, 0, whole(arrays, view))
        history.remember(seen)
    radiance = numbers(history.recall(indices(arrays, np.arange(48 * 48))), "radiance")
    assert got(float(radiance.min()), "g") == got(float(radiance.max()), "g") == 2
