"""The fovea: its modes, what it refuses, its history, and the fusion that a training leaves in a forest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose import fitting
from compose.blend import srgb_from_radiance
from compose.errors import UserError
from compose.foveation import Foveation
from compose.view import Gaze
from hybrid.disc import Underlay
from hybrid.fovea import Fovea
from hybrid.fusing import fusion_of, with_fusion
from hybrid.periphery import Viewing
from hybrid.renderer import HybridRenderer
from pathtrace.capture import CaptureSettings, capture
from pathtrace.film import frame_positions
from pathtrace.scene import load_scene
from pathtrace.tracer import Tracer
from splat.files import load_forest, save_forest
from tests import small
from tests.hybrid.test_renderer import forest_of

pytestmark = pytest.mark.usefixtures("backend")
FOVEATION = Foveation(Gaze(), 45, 35)


@pytest.fixture(scope="module")
def scene(backend):
    return load_scene(small.corner())


@pytest.fixture(scope="module")
def forest(scene):
    return forest_of(scene)


def renderer_of(scene, forest, mode, remembers=False) -> HybridRenderer:
    return HybridRenderer(scene, forest, Viewing(law="none"), mode, remembers)


def test_an_unknown_mode_is_refused(scene):
    with pytest.raises(UserError, match="--fovea sharp: must be raw, denoised or fused"):
        Fovea(Tracer(scene), "sharp")


def test_raw_is_the_mean_of_the_samples(scene, forest):
    camera = scene.camera.resized(64, 64)
    frame = renderer_of(scene, forest, "raw").frame(camera, FOVEATION, spp=3, seed=5)
    assert frame.fovea.radiance is frame.fovea.samples.radiance
    assert frame.fovea.denoised is None
    assert frame.fovea.weights is None


def test_the_variance_is_honest(scene):
    """What runs estimate of their mean's variance is what many of them show.

    On edges stratified samples have less than the estimate, which takes them for independent; never more.
    """
    camera = scene.camera.resized(32, 32)
    fovea, plan = Fovea(Tracer(scene), "raw"), Foveation(Gaze(), 100, 100).plan(32, 32)
    runs = [fovea.disc.trace(camera, plan, 16, seed) for seed in range(40)]
    estimated = np.mean([run.variance() for run in runs], axis=0)
    actual = np.var([run.radiance for run in runs], axis=0, ddof=1)
    noisy = actual > 1e-6
    assert 0.95 < np.median(estimated[noisy] / actual[noisy]) < 1.2
    assert estimated.sum() > 0.9 * actual.sum()


def test_a_fused_fovea_lies_between_its_parents_and_says_how(scene, forest):
    camera = scene.camera.resized(65, 63)
    frame = renderer_of(scene, forest, "fused").frame(camera, FOVEATION, spp=4, seed=1)
    fovea = frame.fovea
    np.testing.assert_allclose(fovea.weights.sum(axis=1), 1, atol=1e-5)
    under = renderer_of(scene, forest, "fused").splat_frame(camera).reshape(-1, 3)[frame.plan.pixels]
    parents = np.stack([fovea.samples.radiance, fovea.denoised, under])
    # Nothing is fitted to this forest: statistics alone, without sharpening.
    mixed = (parents * fovea.weights.T[:, :, None]).sum(axis=0)
    np.testing.assert_allclose(fovea.radiance, mixed, atol=2e-3)


def test_splats_of_another_view_are_refused(scene, forest):
    renderer = renderer_of(scene, forest, "fused")
    camera = scene.camera.resized(48, 48)
    plan = FOVEATION.plan(48, 48)
    samples = renderer.fovea.disc.trace(camera, plan, 1, 0)
    under = renderer.underlay(camera, plan)
    around = np.zeros((48, 48, 3), dtype=np.float32)
    with pytest.raises(ValueError, match="needs the splats' picture"):
        renderer.fovea.picture(camera, plan, samples, around, None)
    smaller = replace(under, radiance=under.radiance[:, :40])
    with pytest.raises(ValueError, match="40 x 48, the frame 48 x 48"):
        renderer.fovea.picture(camera, plan, samples, around, smaller)
    other = Underlay(replace(camera, fx=camera.fx * 1.1), under.radiance, 1.0)
    with pytest.raises(ValueError, match="another camera"):
        renderer.fovea.picture(camera, plan, samples, around, other)


@pytest.mark.parametrize("mode", ["raw", "denoised", "fused"])
def test_no_disc_needs_no_samples(scene, forest, mode):
    renderer = renderer_of(scene, forest, mode)
    camera = scene.camera.resized(32, 32)
    frame = renderer.frame(camera, Foveation(Gaze(5, 5), 10, 5), spp=2)
    np.testing.assert_array_equal(frame.composite, renderer.splat_frame(camera))


def test_a_still_view_converges(scene, forest):
    camera = scene.camera.resized(48, 48)
    truth = renderer_of(scene, forest, "raw").path_traced(camera, frame_positions(camera), 2048, 99)
    renderer = renderer_of(scene, forest, "fused", remembers=True)
    errors = []
    for seed in range(64):
        frame = renderer.frame(camera, FOVEATION, spp=1, seed=seed)
        inside = frame.plan.weight_image() >= 1
        shown = srgb_from_radiance(frame.composite) - srgb_from_radiance(truth)
        errors.append(np.mean(shown[inside] ** 2))
    assert (frame.fovea.samples.count == 64).all()
    assert errors[63] < 0.5 * errors[7] < 0.4 * errors[0]


def test_training_leaves_a_fusion_in_the_forest(arrays, scene, forest, tmp_path, monkeypatch):
    monkeypatch.setattr(fitting, "ITERATIONS", 5)
    settings = CaptureSettings(views=2, held_out=3, width=128, height=128, spp=1, held_out_spp=14)
    frames = capture(scene, tmp_path / "frames", settings, lambda done, total: None)
    steps = []
    found = with_fusion(arrays, frames, forest, 0, lambda done, total: steps.append((done, total)))
    assert steps[-1] == (5, 5)
    assert fusion_of(forest) is None
    save_forest(tmp_path / "f.safetensors", found)
    again = fusion_of(load_forest(tmp_path / "f.safetensors"))
    for name, tensor in fusion_of(found).state_dict().items():
        assert torch.equal(tensor, again.state_dict()[name])


def test_a_damaged_fusion_is_refused(forest):
    with pytest.raises(UserError, match="damaged or of another version"):
        fusion_of(replace(forest, attached={"fusion.reduce.weight": torch.zeros(3)}))


def test_samples_go_where_samples_and_splats_disagree(scene, forest):
    """As many rays as without, and more of them where the splats are wrong."""
    renderer = renderer_of(scene, forest, "fused")
    camera = scene.camera.resized(64, 64)
    plan = Foveation(Gaze(), 100, 100).plan(64, 64)
    under = renderer.underlay(camera, plan)
    wrong = under.radiance.copy()
    wrong[:, 32:] = 1 - np.clip(wrong[:, 32:], 0, 1)
    samples = renderer.fovea.disc.trace(camera, plan, 8, 0, replace(under, radiance=wrong))
    assert samples.count.sum() == 8 * 64 * 64
    count = samples.count.reshape(64, 64)
    assert count.min() >= 2
    assert count[:, 34:].mean() > 1.5 * count[:, :30].mean()
    even = renderer.fovea.disc.trace(camera, plan, 8, 0)
    assert (even.count == 8).all()
