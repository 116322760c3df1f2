"""A reference knows how wrong it is."""

from __future__ import annotations

import numpy as np
import pytest

from compose.image.colour import srgb_from_radiance
from hybrid.measure import reference as module
from hybrid.measure.image_metrics import psnr
from hybrid.measure.reference import Reference, reference
from pathtrace.scene.scene import load_scene
from pathtrace.trace.traced_images import TracedImage
from pathtrace.trace.tracer import Tracer
from tests import small


def flat(value: float) -> np.ndarray:
    return np.full((4, 6, 3), value, dtype=np.float32)


class TestError:
    """Radiance below 0.003 lies on the linear part of sRGB, whose slope is 12.92."""

    def test_without_noise_the_error_is_the_squared_bias_of_the_mean(self):
        """Biases of 0.0004 and -0.0002: that of the mean is 0.0001."""
        truth = flat(0.001)
        halves = flat(0.0014), flat(0.0008)
        found = Reference.of_halves(halves, [[truth, truth], [truth, truth]])
        np.testing.assert_allclose(found.radiance, 0.0011, rtol=1e-6)
        np.testing.assert_allclose(found.errors, (12.92 * 0.0001) ** 2, rtol=1e-2)

    def test_each_half_is_compared_with_the_samples_of_the_other(self):
        """A half equals its own samples: against them it would have no error at all."""
        halves = flat(0.0014), flat(0.0008)
        found = Reference.of_halves(halves, [[halves[0]] * 2, [halves[1]] * 2])
        np.testing.assert_allclose(found.errors, 0.75 * (12.92 * 0.0006) ** 2, rtol=1e-2)

    @pytest.mark.parametrize(("bias", "spread"), [(0.02, 0.0), (0.0, 0.02), (0.01, 0.01)])
    def test_bias_and_noise_of_the_denoised_halves_both_count(self, bias, spread):
        """Samples are far noisier than either; the error of the mean is b^2 + s^2 / 2."""
        rng = small.rng()
        truth = np.tile(np.linspace(0.2, 0.6, 256, dtype=np.float32)[:, None, None], (1, 256, 3))

        def noisy(size: float) -> np.ndarray:
            return truth + rng.normal(0, size, truth.shape).astype(np.float32)

        halves = bias + noisy(spread), bias + noisy(spread)
        found = Reference.of_halves(halves, [[noisy(0.1) for _ in range(2)] for _ in range(2)])
        actual = np.mean((srgb_from_radiance(found.radiance) - srgb_from_radiance(truth)) ** 2)
        # Two standard errors are added, so that it may well be more but hardly ever less.
        assert actual <= found.squared_error() < 2 * actual
        assert found.psnr() == pytest.approx(-10 * np.log10(found.squared_error()))

    def test_two_standard_errors_are_added(self):
        """Errors of 1 and 3 alternate over 24 pixels: 2 + 2 * 1 / sqrt(24)."""
        errors = np.tile(np.array([1, 3], dtype=np.float32), (4, 3))
        found = Reference(flat(0.5), (flat(0.5), flat(0.5)), errors)
        assert found.squared_error() == pytest.approx(2 + 2 / np.sqrt(24))
        assert found.squared_error(errors == 3) == pytest.approx(3)

    def test_it_is_at_least_what_the_halves_differ_by(self):
        """The estimate may be negative; the mean of two halves has a quarter of their squared difference."""
        halves = flat(0.001), flat(0.001)
        halves[1][0] = 0.003
        found = Reference(0.5 * (halves[0] + halves[1]), halves, np.full((4, 6), -1, dtype=np.float32))
        assert found.squared_error() == pytest.approx(0.25 * (12.92 * 0.002) ** 2 / 4, rel=1e-4)
        first = np.zeros((4, 6), dtype=bool)
        first[0] = True
        assert found.squared_error(first) == pytest.approx(0.25 * (12.92 * 0.002) ** 2, rel=1e-4)
        assert found.psnr(~first) == 120


@pytest.mark.usefixtures("backend")
class TestTraced:
    def test_a_reference_does_not_claim_more_than_it_is(self):
        """Against one of 60 times as many samples. What its halves differ by would claim too much."""
        scene = load_scene(small.corner())
        tracer, camera = Tracer(scene), scene.camera.resized(96, 96)
        truth = reference(tracer, camera, 1024, 1)
        few = [reference(tracer, camera, 16, seed) for seed in range(2, 6)]
        actual = np.mean([psnr(found.radiance, truth.radiance) for found in few])
        assert np.mean([found.psnr() for found in few]) < actual
        assert np.mean([psnr(*found.halves) for found in few]) + 10 * np.log10(4) > actual

    def test_more_samples_and_the_same_seed(self):
        scene = load_scene(small.corner())
        tracer, camera = Tracer(scene), scene.camera
        one, again, more = (reference(tracer, camera, spp, 3) for spp in (16, 16, 256))
        np.testing.assert_array_equal(one.radiance, again.radiance)
        assert one.psnr() == again.psnr() < more.psnr()
        assert (one.radiance != reference(tracer, camera, 16, 4).radiance).any()
        assert (one.halves[0] != one.halves[1]).any()
        with pytest.raises(ValueError, match="at least 4 samples"):
            reference(tracer, camera, 3, 0)

    def test_more_samples_in_some_pixels_make_those_better_and_leave_the_others(self):
        scene = load_scene(small.corner())
        tracer, camera = Tracer(scene), scene.camera.resized(64, 64)
        dense = np.zeros((64, 64), dtype=bool)
        dense[16:48, 16:48] = True
        even = reference(tracer, camera, 16, 3)
        uneven = reference(tracer, camera, np.where(dense, 256, 16).ravel(), 3)
        assert uneven.psnr(dense) > even.psnr(dense) + 3
        assert uneven.psnr(~dense) == pytest.approx(even.psnr(~dense), abs=2)

    def test_no_denoiser_touches_raw_references(self, monkeypatch):
        """Nor are auxiliary images traced; the samples are the same, and so is their mean."""
        scene = load_scene(small.corner())
        tracer, camera = Tracer(scene), scene.camera.resized(24, 16)
        denoised = reference(tracer, camera, 16, 3)
        samples = []
        traced = module.radiance_image

        def noted(*arguments):
            samples.append(traced(*arguments))
            return samples[-1]

        monkeypatch.setattr(module, "radiance_image", noted)
        monkeypatch.setattr(module, "auxiliary_images", None)
        monkeypatch.setattr(TracedImage, "denoised", None)
        raw = reference(tracer, camera, 16, 3, denoised=False)
        np.testing.assert_allclose(raw.radiance, np.mean(samples, axis=0), rtol=1e-5, atol=1e-6)
        for half, parts in zip(raw.halves, (samples[:2], samples[2:]), strict=True):
            np.testing.assert_allclose(half, np.mean(parts, axis=0), rtol=1e-5, atol=1e-6)
        assert (raw.radiance != denoised.radiance).any()

    def test_raw_references_know_how_wrong_they_are(self):
        """Against one of 32 times as many samples."""
        scene = load_scene(small.corner())
        tracer, camera = Tracer(scene), scene.camera.resized(48, 48)
        truth = reference(tracer, camera, 2048, 1, denoised=False)
        few = [reference(tracer, camera, 64, seed, denoised=False) for seed in range(2, 6)]
        actual = np.mean([psnr(found.radiance, truth.radiance) for found in few])
        assert np.mean([found.psnr() for found in few]) == pytest.approx(actual, abs=1.5)

    @pytest.mark.parametrize(("spp", "counts"), [(8, [2, 2, 2, 2]), (6, [1, 2, 1, 2]), (7, [1, 2, 2, 2])])
    def test_samples_are_spread_over_four_parts_and_weigh_the_same(self, monkeypatch, spp, counts):
        """Each part is as bright as it has samples, so that a half is the sum of squares over the sum."""
        traced, seeds = [], []

        def part(tracer, camera, positions, columns, count, seed):
            traced.append(count)
            seeds.append(seed)
            return np.full((camera.height, camera.width, 3), count, dtype=np.float32)

        monkeypatch.setattr(module, "radiance_image", part)
        monkeypatch.setattr(TracedImage, "denoised", lambda self: self.radiance)
        scene = load_scene(small.corner())
        found = reference(Tracer(scene), scene.camera.resized(8, 4), spp, 3)
        assert traced == counts
        assert len(set(seeds)) == 4
        for half, (one, other) in zip(found.halves, (counts[:2], counts[2:]), strict=True):
            np.testing.assert_allclose(half, (one**2 + other**2) / (one + other), rtol=1e-6)
