"""What the hybrid frame is compared with shows the same scene, lined up, at the rays that it says."""

from __future__ import annotations

import numpy as np
import pytest
from hybrid.baselines.methods import Enlarged, FullTrace, Warped

from compose.eye.gaze import Gaze
from hybrid.evaluation.budgets import Tuning, WarpTuning, families
from hybrid.measure.metrics.psnr import psnr
from hybrid.measure.metrics.registration import registration_px
from pathtrace.scene.scene import load_scene
from pathtrace.trace.tracer import Tracer

pytestmark = pytest.mark.usefixtures("backend")
GAZE = Gaze(0.4, 0.55)


@pytest.fixture(scope="module")
def tracer(backend) -> Tracer:
    return Tracer(load_scene("cornell"))


def test_an_enlarged_frame_of_full_size_is_the_full_frame(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    full = FullTrace(tracer, 2, denoised=False).make(camera, GAZE, 3)
    same = Enlarged(tracer, 1.0, 2, denoised=False).make(camera, GAZE, 3)
    np.testing.assert_allclose(same.image, full.image, rtol=1e-5, atol=1e-6)
    assert set(full.milliseconds) == {"trace", "total"}
    assert set(same.milliseconds) == {"trace", "enlarge", "total"}


@pytest.mark.parametrize("kind", ["enlarged", "warped"])
def test_peers_line_up_and_converge_to_a_blurred_full_frame(tracer, kind):
    """With many samples nothing but their lower resolution is left."""
    camera = tracer.scene.camera.resized(96, 96)
    truth = FullTrace(tracer, 64, denoised=True).make(camera, GAZE, 0).image
    peer = (
        Enlarged(tracer, 0.25, 64, denoised=False)
        if kind == "enlarged"
        else Warped(tracer, 0.4, 1.5, 64, denoised=False)
    )
    made = peer.make(camera, GAZE, 1)
    assert made.image.shape == truth.shape
    assert psnr(made.image, truth) > 20
    shift = registration_px(made.image, truth)
    assert shift is None or shift < 0.35
    if kind == "warped":
        # It is sharpest, and so best, at the gaze.
        near, far = np.s_[42:62, 28:48], np.s_[:20, -20:]
        error = np.abs(made.image - truth)
        assert error[near].mean() / truth[near].mean() < error[far].mean() / truth[far].mean()


def test_rays_are_what_is_traced(tracer):
    camera = tracer.scene.camera.resized(90, 60)
    assert FullTrace(tracer, 3, denoised=False).rays(camera, GAZE) == 3
    assert Enlarged(tracer, 0.25, 2, denoised=True).rays(camera, GAZE) == pytest.approx(0.5)
    assert Warped(tracer, 0.1, 3.0, 2, denoised=False).rays(camera, GAZE) == pytest.approx(2 / 9)


def test_the_same_seed_gives_the_same_frame(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    peer = Warped(tracer, 0.1, 2.0, 2, denoised=True)
    np.testing.assert_array_equal(peer.make(camera, GAZE, 5).image, peer.make(camera, GAZE, 5).image)
    assert np.abs(peer.make(camera, GAZE, 5).image - peer.make(camera, GAZE, 6).image).max() > 0


def test_a_fraction_of_a_sample_goes_to_a_fraction_of_the_pixels(tracer, monkeypatch):
    camera = tracer.scene.camera.resized(48, 32)
    asked, trace = [], tracer.trace

    def recorded(camera, positions, spp, seed):
        asked.append(spp)
        return trace(camera, positions, spp, seed)

    monkeypatch.setattr(tracer, "trace", recorded)
    one, same, other = (
        FullTrace(tracer, 2.25, denoised=False).make(camera, GAZE, seed).image for seed in (3, 3, 4)
    )
    FullTrace(tracer, 2.0, denoised=False).make(camera, GAZE, 3)
    assert asked[0].mean() == pytest.approx(2.25)
    assert set(asked[0]) == {2, 3}
    # Scattered over the frame, not one part of it.
    assert 0.15 < (asked[0][: 24 * 32] == 3).mean() < 0.35
    assert asked[3] == 2
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    many, more = (FullTrace(tracer, spp, denoised=False).make(camera, GAZE, 3).image for spp in (128, 128.5))
    assert many.mean() == pytest.approx(more.mean(), rel=0.06)


@pytest.mark.parametrize("rays", [0.2, 1.3, 2.01, 5.5])
def test_all_families_take_the_rays_that_they_are_given(tracer, rays):
    camera = tracer.scene.camera.resized(96, 64)
    tuning = Tuning(WarpTuning(0.4, 2, False), WarpTuning(0.1, 1, True), 2)
    known = families(tracer, tuning)
    assert list(known) == [
        "full",
        "full, denoised",
        "enlarged",
        "enlarged, denoised",
        "rmfr",
        "rmfr, tuned",
        "rmfr, tuned for the fovea",
    ]
    for name, family in known.items():
        # The cheapest full frame has one sample of each pixel, FPC's buffer one of each of its own.
        least = {"full": 1.0, "full, denoised": 1.0, "rmfr": 1 / 2.6**2}.get(name, 0.0)
        peer = family(rays)
        assert peer.rays(camera, GAZE) == pytest.approx(max(rays, least), rel=0.03), name
        # No samples are spent on places that the frame does not have.
        assert getattr(peer, "share", 1.0) <= 1 + 1e-9
        assert name == "rmfr" or getattr(peer, "sigma", 1.0) >= 1 - 1e-9
