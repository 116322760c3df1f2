"""What the hybrid frame is compared with shows the same scene, lined up, at the rays that it says."""

from __future__ import annotations

import numpy as np
import pytest

from compose.view import Gaze
from hybrid.evaluate.peers import Enlarged, FullTrace, Warped
from hybrid.metrics.registration import registration_px
from hybrid.metrics.similarity import psnr
from pathtrace.scene import load_scene
from pathtrace.tracer import Tracer

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
