"""Path-traced images: fractions of samples, and denoising."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.base.compute_device import PassClock
from hybrid.evaluation.methods import traced_image
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer

pytestmark = pytest.mark.usefixtures("backend")
WIDTH, HEIGHT = 48, 32


@pytest.fixture(scope="module")
def tracer(backend) -> Tracer:
    return Tracer(load_scene("cornell"))


def image(tracer: Tracer, spp: float, seed: int = 3, denoised: bool = False, clock: PassClock | None = None):
    camera = tracer.scene.camera.resized(WIDTH, HEIGHT)
    return traced_image(
        tracer, camera, frame_positions(camera), WIDTH, spp, seed, denoised, clock or PassClock()
    )


def test_a_fraction_of_a_sample_goes_to_a_fraction_of_the_pixels(tracer, monkeypatch):
    asked, trace = [], tracer.trace

    def recorded(camera, positions, spp, seed):
        asked.append(spp)
        return trace(camera, positions, spp, seed)

    monkeypatch.setattr(tracer, "trace", recorded)
    one, same, other = (image(tracer, 2.25, seed) for seed in (3, 3, 4))
    image(tracer, 2.0)
    assert asked[0].mean() == pytest.approx(2.25)
    assert set(asked[0]) == {2, 3}
    # Scattered over the frame, not one part of it.
    assert 0.15 < (asked[0][: 24 * 32] == 3).mean() < 0.35
    assert asked[3] == 2
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    many, more = image(tracer, 128), image(tracer, 128.5)
    assert many.mean() == pytest.approx(more.mean(), rel=0.06)


def test_denoising_removes_noise_and_is_timed(tracer):
    truth = image(tracer, 256, seed=9)
    clocks = PassClock(), PassClock()
    raw, denoised = (image(tracer, 4, denoised=flag, clock=clocks[flag]) for flag in (False, True))
    assert raw.shape == denoised.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(denoised - truth).mean() < 0.85 * np.abs(raw - truth).mean()
    assert list(clocks[0].milliseconds()) == ["trace", "total"]
    assert list(clocks[1].milliseconds()) == ["trace", "denoise", "total"]


@pytest.mark.parametrize("spp", [1.5, 64])
def test_the_better_denoiser_is_used_at_any_sample_count(tracer, monkeypatch, spp):
    from pathtrace.trace.traced_images import TracedImage

    asked = []
    monkeypatch.setattr(
        TracedImage, "denoised", lambda self, quick=False: (asked.append(quick), self.radiance)[1]
    )
    image(tracer, spp, denoised=True)
    assert asked == [False]
