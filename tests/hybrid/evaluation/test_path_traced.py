"""Path-traced baselines show the same scene, lined up, with the rays that they claim."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from hybrid.evaluation import methods as path_traced
from hybrid.evaluation.methods import Enlarged, FullTrace, Rmfr
from hybrid.measure.image_metrics import psnr, registration_px
from pathtrace.scene.scene import load_scene
from pathtrace.trace.tracer import Tracer

pytestmark = pytest.mark.usefixtures("backend")
GAZE = Gaze(0.4, 0.55)


@pytest.fixture(scope="module")
def tracer(backend) -> Tracer:
    return Tracer(load_scene("cornell"))


def test_an_enlarged_frame_of_full_size_is_the_full_frame(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    full = FullTrace(tracer, 2, denoised=False).render(View(camera), GAZE, 3)
    same = Enlarged(tracer, 1.0, 2, denoised=False).render(View(camera), GAZE, 3)
    np.testing.assert_allclose(same.image, full.image, rtol=1e-5, atol=1e-6)


def test_passes_are_named_and_add_up(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    for method, passes in (
        (FullTrace(tracer, 1, denoised=False), {"trace"}),
        (FullTrace(tracer, 1, denoised=True), {"trace", "denoise"}),
        (Enlarged(tracer, 0.5, 1, denoised=False), {"trace", "enlarge"}),
        (Rmfr(tracer, 0.4, 1.5, 1, denoised=True), {"trace", "denoise", "enlarge"}),
    ):
        milliseconds = method.render(View(camera), GAZE, 0).milliseconds
        assert set(milliseconds) == {*passes, "total"}
        assert milliseconds["total"] == pytest.approx(sum(milliseconds[name] for name in passes))


@pytest.mark.parametrize("kind", ["enlarged", "rmfr"])
def test_baselines_line_up_and_converge_to_a_blurred_full_frame(tracer, kind):
    """With many samples nothing but their lower resolution is left."""
    camera = tracer.scene.camera.resized(96, 96)
    truth = FullTrace(tracer, 64, denoised=True).render(View(camera), GAZE, 0).image
    if kind == "enlarged":
        image = Enlarged(tracer, 0.25, 64, denoised=False).render(View(camera), GAZE, 1).image
    else:
        image = Rmfr(tracer, 0.4, 1.5, 64, denoised=False).render(View(camera), GAZE, 1).image
    assert image.shape == truth.shape
    assert image.min() >= 0
    assert psnr(image, truth) > 20
    shift = registration_px(image, truth)
    assert shift is None or shift < 0.35
    if kind == "rmfr":
        # It is sharpest, and so best, at the gaze.
        near, far = np.s_[42:62, 28:48], np.s_[:20, -20:]
        error = np.abs(image - truth)
        assert error[near].mean() / truth[near].mean() < error[far].mean() / truth[far].mean()


def test_enlarging_is_bicubic_and_keeps_pixels_where_they_are(tracer, monkeypatch):
    """A ramp, traced with half of the resolution, comes back as the same ramp; overshoot is cut at 0."""

    def ramp(tracer, camera, positions, columns, *rest):
        rows = positions.count // columns
        across = (np.arange(columns) + 0.5) * camera.width / columns
        return np.broadcast_to(across[None, :, None], (rows, columns, 3)).astype(np.float32).copy()

    monkeypatch.setattr(path_traced, "traced_image", ramp)
    camera = tracer.scene.camera.resized(48, 32)
    image = Enlarged(tracer, 0.25, 1, denoised=False).render(View(camera), GAZE, 0).image
    assert image.shape == (32, 48, 3)
    expected = np.broadcast_to((np.arange(48) + 0.5)[None, :, None], (32, 48, 3))
    # A ramp comes back exactly only in the limit; an offset of half a pixel would be 0.5 or more.
    np.testing.assert_allclose(image[:, 4:-4], expected[:, 4:-4], atol=0.1)

    def edge(*arguments):
        image = ramp(*arguments)
        return np.where(image < 24, 0, 5).astype(np.float32)

    monkeypatch.setattr(path_traced, "traced_image", edge)
    image = Enlarged(tracer, 0.25, 1, denoised=False).render(View(camera), GAZE, 0).image
    assert image.min() == 0
    assert image.max() > 5.1


def test_rays_are_what_is_traced(tracer, monkeypatch):
    """Columns and rows of the traced image, times its samples, over the pixels of the frame."""
    camera = tracer.scene.camera.resized(90, 60)
    traced = []

    def counted(tracer, camera, positions, columns, spp, seed, denoised, clock):
        traced.append(positions.count * spp / (camera.width * camera.height))
        return np.zeros((positions.count // columns, columns, 3), dtype=np.float32)

    monkeypatch.setattr(path_traced, "traced_image", counted)
    for method, rays in (
        (FullTrace(tracer, 3, denoised=False), 3),
        (FullTrace(tracer, 1.25, denoised=True), 1.25),
        (Enlarged(tracer, 0.25, 2, denoised=True), 0.5),
        (Enlarged(tracer, 1e-9, 2, denoised=True), 2 / 5400),
        (Rmfr(tracer, 0.1, 3.0, 2, denoised=False), 2 / 9),
    ):
        assert method.rays(camera, GAZE) == pytest.approx(rays)
        method.render(View(camera), GAZE, 0)
        assert traced[-1] == pytest.approx(rays)


def test_settings_tell_methods_apart_in_tables(tracer):
    assert FullTrace(tracer, 2.5, denoised=True).settings == {"spp": 2.5}
    assert Enlarged(tracer, 0.25, 4, denoised=True).settings == {"spp": 4, "scale": 0.5}
    rmfr = Rmfr(tracer, 0.4, 1.5, 2, denoised=True).settings
    assert rmfr == {"spp": 2, "f": 0.4, "sigma": 1.5, "denoised": "true"}


def test_the_same_seed_gives_the_same_frame(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    method = Rmfr(tracer, 0.1, 2.0, 2, denoised=True)
    one, same, other = (method.render(View(camera), GAZE, seed).image for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0
