"""The samples of a disc: their number, their variance, where they go, and what earlier frames add."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from compose.base.arrays import uploaded
from compose.base.traced_samples import Counts
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.base.compute_device import device_arrays
from hybrid.render.disc_images import Underlay
from hybrid.render.disc_tracer import DiscRequest, DiscTracer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.trace.film import frame_positions, interleaved, pixel_positions
from pathtrace.trace.tracer import Tracer
from tests.compose.arrays_of import image_on, numbers

COVERING = Foveation(Gaze(), 500, 500)
DISC = Foveation(Gaze(0.4, 0.6), 40, 30)


@pytest.fixture(scope="module")
def tracer(scene) -> Tracer:
    return Tracer(scene)


def request(scene, foveation: Foveation, size: int, spp: int, seed: int, auxiliary: bool = True):
    camera = scene.camera.resized(size, size)
    disc = foveation.region(size, size).disc(device_arrays())
    return DiscRequest(camera, disc, spp, seed, auxiliary)


def test_the_variance_is_honest(scene, tracer):
    """The variance that runs estimate for their mean is the one that many of them show.

    On edges stratified samples have less than the estimate, which takes them for independent; never more.
    """
    disc = DiscTracer(tracer, history=False)
    runs = [disc.trace(request(scene, COVERING, 32, 16, seed, False)) for seed in range(40)]
    estimated = np.mean([numbers(run, "variance") for run in runs], axis=0)
    actual = np.var([numbers(run, "radiance") for run in runs], axis=0, ddof=1)
    noisy = actual > 1e-6
    assert 0.95 < np.median(estimated[noisy] / actual[noisy]) < 1.2
    assert estimated.sum() > 0.9 * actual.sum()


def test_auxiliary_features_are_traced_when_required(scene, tracer):
    disc = DiscTracer(tracer, history=False)
    without = disc.trace(request(scene, DISC, 32, 1, 3, auxiliary=False))
    with_them = disc.trace(request(scene, DISC, 32, 1, 3))
    np.testing.assert_array_equal(numbers(without, "radiance"), numbers(with_them, "radiance"))
    assert (numbers(without, "albedo") == 0).all()
    assert (numbers(without, "normal") == 0).all()
    # Most of the disc shows the wall; normals are unit vectors, shorter where they are averaged.
    np.testing.assert_allclose(np.median(numbers(with_them, "albedo"), axis=0), [0.7, 0.6, 0.3], atol=1e-3)
    lengths = np.linalg.norm(numbers(with_them, "normal"), axis=1)
    assert np.median(lengths) == pytest.approx(1, abs=1e-3)
    assert lengths.max() < 1 + 1e-3


def test_each_pixel_can_have_a_count_of_its_own(scene, tracer, arrays):
    camera, disc = scene.camera.resized(32, 32), DISC.region(32, 32).disc(arrays)
    counts = 1 + np.arange(disc.count) % 3
    alone = DiscTracer(tracer, history=False)
    each = lambda of: Counts.of(uploaded(arrays.plain.UInt, of.astype(np.uint32)), 3)  # noqa: E731
    samples = alone.trace_each(camera, disc.pixels, each(counts), 5)
    np.testing.assert_array_equal(numbers(samples, "count"), counts)
    np.testing.assert_array_equal(numbers(samples, "pixels"), np.asarray(disc.pixels))
    assert (np.isinf(numbers(samples, "variance")).all(axis=1) == (counts == 1)).all()
    # Equal counts are those of a disc without auxiliary features.
    whole = numbers(alone.trace(DiscRequest(camera, disc, 2, 5, auxiliary=False)), "radiance")
    for even in (each(counts * 0 + 2), 2):
        found = alone.trace_each(camera, disc.pixels, even, 5)
        np.testing.assert_array_equal(numbers(found, "radiance"), whole)


def test_no_pixels_have_no_samples(scene, tracer, arrays):
    nowhere = Foveation(Gaze(5, 5), 10, 5)
    for history in (False, True):
        disc = DiscTracer(tracer, history)
        assert disc.trace(request(scene, nowhere, 32, 4, 0)).size == 0
    none = dr.zeros(arrays.plain.UInt, 0)
    assert numbers(disc.trace_each(scene.camera, none, Counts(none, 0, 0), 0), "radiance").shape == (0, 3)


def splats_under(renderer, camera: Camera, foveation: Foveation = COVERING) -> Underlay:
    """The splats under a disc."""
    settings = FrameSettings(fovea="fused", camera=camera)
    return renderer.underlay(camera, settings, foveation.region(camera.width, camera.height))


def wrong_right_half(renderer, camera: Camera) -> Underlay:
    """The splats of a frame, inverted on the right."""
    underlay = splats_under(renderer, camera)
    wrong = np.array(underlay.radiance.numpy())
    wrong[:, 32:] = 1 - np.clip(wrong[:, 32:], 0, 1)
    return replace(underlay, radiance=image_on(underlay.radiance.arrays, wrong))


def test_samples_go_where_samples_and_splats_disagree(scene, renderer, tracer):
    """As many rays as without, and more of them where the splats are wrong."""
    asked = request(scene, COVERING, 64, 8, 0)
    underlay = wrong_right_half(renderer, asked.camera)
    disc = DiscTracer(tracer, history=False)
    count = numbers(disc.trace(asked, underlay), "count").reshape(64, 64)
    assert count.sum() == 8 * 64 * 64
    assert count.min() >= 2
    assert count[:, 34:].mean() > 1.5 * count[:, :30].mean()
    for even in (
        disc.trace(asked),
        disc.trace(asked, underlay, quick=True),
        disc.trace(replace(asked, spp=3), underlay),
    ):
        assert np.ptp(numbers(even, "count")) == 0


@pytest.mark.parametrize(("spp", "everywhere"), [(4, 2), (8, 2), (16, 4)])
def test_a_quarter_of_the_samples_and_two_at_least_are_traced_everywhere(
    scene, renderer, tracer, spp, everywhere
):
    asked = request(scene, COVERING, 64, spp, 0)
    underlay = wrong_right_half(renderer, asked.camera)
    count = numbers(DiscTracer(tracer, history=False).trace(asked, underlay), "count")
    assert count.sum() == spp * 64 * 64
    # Where the splats are right, these are all.
    assert count.min() == everywhere
    assert (count == everywhere).mean() > 0.2


@pytest.mark.parametrize("spp", [1, 3, 4, 8, 64])
@pytest.mark.parametrize("adaptive", [False, True])
def test_auxiliary_features_are_means_over_4_samples_or_more(scene, renderer, tracer, spp, adaptive):
    asked = request(scene, COVERING, 32, spp, 5)
    underlay = splats_under(renderer, asked.camera) if adaptive else None
    found = DiscTracer(tracer, history=False).trace(asked, underlay)
    everywhere = frame_positions(asked.camera)
    truth = interleaved(tracer.auxiliary(asked.camera, everywhere, 1024, 1).albedo)
    four = interleaved(tracer.auxiliary(asked.camera, everywhere, 4, 5).albedo)
    errors = (np.abs(albedo - truth).mean() for albedo in (numbers(found, "albedo"), four))
    assert next(errors) <= 1.02 * next(errors)
    assert (np.linalg.norm(numbers(found, "position"), axis=1) > 0).all()


def test_adaptive_samples_are_unbiased(scene, renderer, tracer):
    """Where samples go depends on the first ones only, so that the mean over runs is that of even samples."""
    asked = request(scene, COVERING, 64, 8, 0)
    underlay = wrong_right_half(renderer, asked.camera)
    disc = DiscTracer(tracer, history=False)
    right = np.tile(np.arange(64) >= 34, 64)

    def mean(seed: int, *under: Underlay) -> float:
        return numbers(disc.trace(replace(asked, seed=seed), *under), "radiance")[right].mean()

    even = np.mean([mean(seed) for seed in range(8)])
    runs = [mean(seed, underlay) for seed in range(8, 16)]
    assert np.mean(runs) == pytest.approx(even, abs=5 * np.std(runs, ddof=1) / np.sqrt(8) + 1e-6)


def test_an_underlay_of_another_camera_is_refused(scene, renderer, tracer):
    asked = request(scene, DISC, 48, 8, 0)
    underlay = splats_under(renderer, asked.camera, DISC)
    other = replace(underlay, camera=replace(asked.camera, fx=asked.camera.fx * 1.1))
    with pytest.raises(ValueError, match="another camera"):
        DiscTracer(tracer, history=False).trace(asked, other)


def test_without_a_history_nothing_is_remembered(scene, tracer):
    disc = DiscTracer(tracer, history=False)
    assert not disc.has_history
    assert disc.history_state() == {}
    asked = request(scene, DISC, 32, 2, 1)
    first = disc.trace(asked)
    np.testing.assert_array_equal(numbers(disc.trace(asked), "radiance"), numbers(first, "radiance"))
    disc.forget()
    disc.restore_history(asked.camera, {})
    assert not disc.has_history


@pytest.mark.parametrize("quick", [False, True])
def test_with_a_history_samples_of_a_still_view_add_up(scene, tracer, quick):
    disc = DiscTracer(tracer, history=True)
    assert disc.has_history
    means = []
    for seed in range(4):
        samples = disc.trace(request(scene, DISC, 32, 2, seed), quick=quick)
        assert (numbers(samples, "count") == 2 * (seed + 1)).all()
        means.append(numbers(samples, "radiance"))
    # Each mean holds the one before it: sums grow by what two samples have.
    added = [4 * means[1] - 2 * means[0], 8 * means[3] - 6 * means[2]]
    assert all((new >= -1e-3).all() for new in added)
    disc.forget()
    assert (numbers(disc.trace(request(scene, DISC, 32, 2, 9)), "count") == 2).all()


def test_quick_samples_bring_their_own_auxiliary_features(scene, tracer):
    """The first ones are completed to the four sample positions of a single frame; later ones add up."""
    disc, asked = DiscTracer(tracer, history=True), request(scene, DISC, 32, 1, 5)
    positions = pixel_positions(mi.UInt32(asked.disc.pixels), 32)
    for frame, spp in ((0, 4), (1, 5), (2, 6)):
        found = disc.trace(replace(asked, seed=5 + frame), quick=True)
        assert (numbers(found, "count") == frame + 1).all()
        if frame == 0:
            expected = tracer.auxiliary(asked.camera, positions, spp, 5)
            np.testing.assert_allclose(numbers(found, "albedo"), interleaved(expected.albedo), atol=1e-6)
            np.testing.assert_allclose(numbers(found, "normal"), interleaved(expected.normal), atol=1e-6)
            first = found
        else:
            # The position stays; of a mean of features, one sample more changes its share at most.
            position, normal, albedo = (
                numbers(found, name) - numbers(first, name) for name in ("position", "normal", "albedo")
            )
            assert (position == 0).all()
            assert np.abs(normal).max() <= 2 * (spp - 4) / spp + 1e-6
            assert np.median(np.abs(albedo)) < 1e-6


def test_samples_of_a_still_view_fill_the_gaps_between_earlier_ones(scene, tracer):
    """Four frames of 4 samples each have less error than four frames that know nothing of each other."""
    truth = numbers(DiscTracer(tracer, False).trace(request(scene, DISC, 48, 1024, 77, False)), "radiance")
    errors = []
    for base in range(0, 400, 100):
        disc = DiscTracer(tracer, history=True)
        for seed in range(4):
            summed = disc.trace(request(scene, DISC, 48, 4, base + seed))
        alone = DiscTracer(tracer, history=False)
        apart = [alone.trace(request(scene, DISC, 48, 4, base + seed)) for seed in range(4)]
        images = numbers(summed, "radiance"), np.mean([numbers(run, "radiance") for run in apart], axis=0)
        errors.append([np.mean((image - truth) ** 2) for image in images])
    summed, independent = np.mean(errors, axis=0)
    # Seen: 0.51.
    assert summed < 0.8 * independent


def test_a_saved_history_goes_on_as_if_it_had_never_stopped(scene, tracer):
    whole, first, second = (DiscTracer(tracer, history=True) for _ in range(3))
    for seed in range(3):
        whole.trace(request(scene, DISC, 32, 1, seed))
        first.trace(request(scene, DISC, 32, 1, seed))
    state = {name: np.copy(values) for name, values in first.history_state().items()}
    second.restore_history(scene.camera.resized(32, 32), state)
    expected, found = (disc.trace(request(scene, DISC, 32, 1, 3)) for disc in (whole, second))
    np.testing.assert_array_equal(numbers(found, "radiance"), numbers(expected, "radiance"))
    np.testing.assert_array_equal(numbers(found, "count"), numbers(expected, "count"))
    assert (numbers(found, "count") == 4).all()


def test_gaps_are_filled_where_a_neighbourhood_lacks_samples(scene, tracer):
    """The gaze moves: what the disc newly covers gets samples, what was seen before gets fewer."""
    disc = DiscTracer(tracer, history=True)
    for seed in range(8):
        disc.trace(request(scene, Foveation(Gaze(0.3, 0.5), 30, 30), 64, 2, seed))
    moved = request(scene, Foveation(Gaze(0.6, 0.5), 30, 30), 64, 2, 8)
    before = numbers(disc.known(moved), "count")
    after = numbers(disc.trace(moved), "count")
    assert (before == 0).any()
    assert (before == 16).any()
    assert after.sum() == before.sum() + 2 * len(after)
    new = after - before
    assert new[before == 0].min() >= 1
    assert new[before == 0].mean() > 2 > new[before == 16].mean()
