"""Ablations of hybrid frames."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode, Placement
from hybrid.evaluation.ablations import ablations
from hybrid.evaluation.methods import HybridMethod
from hybrid.render.forest_attachments import attach_errors
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import EVALUATION, FrameSettings
from pathtrace.trace import Integrator
from tests.hybrid.forests import white_dot

pytestmark = pytest.mark.usefixtures("backend")


def changes(settings: FrameSettings, made: FrameSettings) -> dict[str, object]:
    """What differs between settings, but for the number of samples."""
    names = [field.name for field in fields(settings) if field.name not in ("spp", "integrator")]
    found = {name: getattr(made, name) for name in names if getattr(made, name) != getattr(settings, name)}
    if made.used_integrator is not settings.used_integrator:
        found["integrator"] = made.used_integrator
    return found


def changed(renderer: Renderer, settings: FrameSettings) -> dict[str, dict[str, object]]:
    """What each ablation changes, by its name after "hybrid, "."""
    made = {name: family(1.0).frame_settings for name, family in ablations(renderer, settings).items()}
    return {name.removeprefix("hybrid, "): changes(settings, one) for name, one in made.items()}


@pytest.fixture
def knowing(corner, rough) -> Renderer:
    """With a forest that knows where it is wrong."""
    return Renderer(corner, attach_errors(rough, torch.linspace(0, 0.02, rough.counts[0])))


def test_each_lacks_one_part(renderer):
    assert changed(renderer, EVALUATION) == {
        "without fusion": {"fovea": FoveaMode.DENOISED},
        "without denoising": {"fovea": FoveaMode.RAW},
        "without levels": {"layers": (3, 3)},
        "without the acuity model": {"acuity_model": "none"},
        "without infill": {"fill": False},
        "without the cache": {"integrator": Integrator.PATH},
    }


def test_paths_are_placed_the_other_way_where_the_forest_knows_its_errors(knowing):
    needed = replace(EVALUATION, paths=Placement.WHERE_NEEDED)
    assert changed(knowing, EVALUATION)["with paths where needed"] == {"paths": Placement.WHERE_NEEDED}
    found = changed(knowing, needed)
    assert found["with paths in the disc"] == {"paths": Placement.DISC}
    assert "with paths where needed" not in found


def test_what_is_not_there_is_not_left_out(corner, renderer):
    """A forest of one layer, and frames without the other parts."""
    dot = replace(white_dot((0, 0, 0)), scene_name=corner.name, scene_hash=corner.hash)
    bare = FrameSettings(fovea="raw", integrator="path", acuity_model="none", fill=False)
    assert changed(Renderer(corner, dot), bare) == {}
    assert "without levels" not in changed(renderer, FrameSettings(level=1.0))


@pytest.mark.parametrize(("times", "spp"), [(0.2, 1), (1.0, 1), (2.7, 3), (16.2, 16)])
def test_samples_are_whole_and_their_rays_the_nearest(knowing, times, spp):
    camera = knowing.scene.camera.resized(640, 320)
    settings = replace(EVALUATION, camera=camera)
    rays = times * HybridMethod(knowing, settings).rays(camera, settings.gaze)
    families = ablations(knowing, settings)
    # A raw fovea has fewer samples in its band.
    raw = families.pop("hybrid, without denoising")(rays)
    one = HybridMethod(knowing, replace(raw.frame_settings, spp=1)).rays(camera, settings.gaze)
    assert raw.frame_settings.spp >= spp
    assert abs(raw.rays(camera, settings.gaze) - max(rays, one)) <= 0.51 * one
    for name, family in families.items():
        made = family(rays)
        assert made.frame_settings.spp == spp, name
        assert made.rays(camera, settings.gaze) == pytest.approx(spp * rays / times, rel=0.1), name


def test_frames_without_a_disc_have_one_sample(renderer):
    families = ablations(renderer, replace(EVALUATION, fov_a=0, fov_b=0))
    assert {family(0.5).frame_settings.spp for family in families.values()} == {1}


def test_ablations_are_rendered_without_their_part(renderer):
    view, gaze = View(renderer.scene.camera.resized(64, 48)), Gaze(0.2, 0.2)
    made = {
        name: one(0.01).render(view, gaze, 1).image for name, one in ablations(renderer, EVALUATION).items()
    }
    ours = HybridMethod(renderer, EVALUATION).render(view, gaze, 1).image
    differ = {name for name, image in made.items() if np.abs(image - ours).max() > 1e-3}
    # The forest claims to know more than any frame shows, and the eye resolves all of so small a frame.
    assert differ == {f"hybrid, without {part}" for part in ("fusion", "denoising", "the cache")}
