"""A reference knows how wrong it is."""

from __future__ import annotations

import numpy as np
import pytest

from compose.image.colour import srgb_from_radiance
from hybrid.measure.metrics.psnr import psnr
from hybrid.measure.reference import judged, reference
from pathtrace.scene.scene import load_scene
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


@pytest.mark.parametrize(("bias", "spread"), [(0.02, 0.0), (0.0, 0.02), (0.01, 0.01)])
def test_bias_and_noise_of_the_denoised_halves_both_count(bias, spread):
    """Samples are far noisier than either; the error of the mean is b^2 + s^2 / 2."""
    rng = small.rng()
    truth = np.tile(np.linspace(0.2, 0.6, 256, dtype=np.float32)[:, None, None], (1, 256, 3))
    noise = lambda size: rng.normal(0, size, truth.shape).astype(np.float32)  # noqa: E731
    halves = [truth + bias + noise(spread) for _ in range(2)]
    parts = [[truth + noise(0.1) for _ in range(2)] for _ in range(2)]
    found = judged(halves, parts)
    actual = np.mean((srgb_from_radiance(found.radiance) - srgb_from_radiance(truth)) ** 2)
    # Two standard errors are added, so that it may well be more but hardly ever less.
    assert actual <= found.squared_error() < 2 * actual
    assert found.psnr() == pytest.approx(-10 * np.log10(found.squared_error()))


def test_a_reference_does_not_claim_more_than_it_is():
    """Against one of 60 times as many samples. What its denoised halves differ by would claim too much."""
    scene = load_scene(small.corner())
    tracer, camera = Tracer(scene), scene.camera.resized(96, 96)
    truth = reference(tracer, camera, 1024, 1)
    few = [reference(tracer, camera, 16, seed) for seed in range(2, 6)]
    actual = np.mean([psnr(found.radiance, truth.radiance) for found in few])
    assert np.mean([found.psnr() for found in few]) < actual
    assert np.mean([psnr(*found.halves) for found in few]) + 10 * np.log10(4) > actual


def test_more_samples_and_the_same_seed():
    scene = load_scene(small.corner())
    tracer, camera = Tracer(scene), scene.camera
    one, again, more = (reference(tracer, camera, spp, 3) for spp in (16, 16, 256))
    np.testing.assert_array_equal(one.radiance, again.radiance)
    assert one.psnr() == again.psnr() < more.psnr()
    with pytest.raises(ValueError, match="at least 4 samples"):
        reference(tracer, camera, 3, 0)


def test_more_samples_in_some_pixels_make_those_better_and_leave_the_others():
    scene = load_scene(small.corner())
    tracer, camera = Tracer(scene), scene.camera.resized(64, 64)
    dense = np.zeros((64, 64), dtype=bool)
    dense[16:48, 16:48] = True
    even = reference(tracer, camera, 16, 3)
    uneven = reference(tracer, camera, np.where(dense, 256, 16).ravel(), 3)
    assert uneven.psnr(dense) > even.psnr(dense) + 3
    assert uneven.psnr(~dense) == pytest.approx(even.psnr(~dense), abs=2)
