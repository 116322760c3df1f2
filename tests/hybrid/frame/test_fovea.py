"""The fovea: its modes, what it refuses, its history, and the fusion that a training leaves in a forest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from compose.fusion import fitting
from compose.image.colour import srgb_from_radiance
from hybrid.frame.disc import Underlay
from hybrid.frame.fovea import Fovea
from hybrid.frame.fusion import fusion_of
from hybrid.frame.periphery import Viewing
from hybrid.frame.renderer import HybridRenderer
from hybrid.training.fusion import with_fusion
from pathtrace.dataset.capture import capture
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from splat.io.forest_file import load_forest, save_forest
from tests import small
from tests.hybrid.frame.test_renderer import forest_of

pytestmark = pytest.mark.usefixtures("backend")
FOVEATION = Foveation(Gaze(), 45, 35)


@pytest.fixture(scope="module")
def scene(backend):
    return load_scene(small.corner())


@pytest.fixture(scope="module")
def forest(scene):
    return forest_of(scene)


def renderer_of(scene, forest, mode, remembers=False) -> HybridRenderer:
    return HybridRenderer(scene, forest, Viewing(acuity_model="none"), mode, remembers)


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
    fovea, region = Fovea(Tracer(scene), "raw"), Foveation(Gaze(), 100, 100).region(32, 32)
    runs = [fovea.disc.trace(camera, region, 16, seed) for seed in range(40)]
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
    underlay = renderer_of(scene, forest, "fused").splat_frame(camera).reshape(-1, 3)[frame.region.pixels]
    parents = np.stack([fovea.samples.radiance, fovea.denoised, underlay])
    # Nothing is fitted to this forest: statistics alone, without sharpening.
    mixed = (parents * fovea.weights.T[:, :, None]).sum(axis=0)
    np.testing.assert_allclose(fovea.radiance, mixed, atol=2e-3)


def test_splats_of_another_view_are_refused(scene, forest):
    renderer = renderer_of(scene, forest, "fused")
    camera = scene.camera.resized(48, 48)
    region = FOVEATION.region(48, 48)
    samples = renderer.fovea.disc.trace(camera, region, 1, 0)
    underlay = renderer.underlay(camera, region)
    around = np.zeros((48, 48, 3), dtype=np.float32)
    with pytest.raises(ValueError, match="needs the splats' picture"):
        renderer.fovea.picture(camera, region, samples, around, None)
    smaller = replace(underlay, radiance=underlay.radiance[:, :40])
    with pytest.raises(ValueError, match="40 x 48, the frame 48 x 48"):
        renderer.fovea.picture(camera, region, samples, around, smaller)
    other = Underlay(replace(camera, fx=camera.fx * 1.1), underlay.radiance, 1.0)
    with pytest.raises(ValueError, match="another camera"):
        renderer.fovea.picture(camera, region, samples, around, other)


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
        inside = frame.region.weight_image() >= 1
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
    region = Foveation(Gaze(), 100, 100).region(64, 64)
    underlay = renderer.underlay(camera, region)
    wrong = underlay.radiance.copy()
    wrong[:, 32:] = 1 - np.clip(wrong[:, 32:], 0, 1)
    samples = renderer.fovea.disc.trace(camera, region, 8, 0, replace(underlay, radiance=wrong))
    assert samples.count.sum() == 8 * 64 * 64
    count = samples.count.reshape(64, 64)
    assert count.min() >= 2
    assert count[:, 34:].mean() > 1.5 * count[:, :30].mean()
    even = renderer.fovea.disc.trace(camera, region, 8, 0)
    assert (even.count == 8).all()
