"""What a scene requires, against what a careful person would write."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.view import View
from compose.eye.display import DISPLAYS
from compose.image.colour import srgb_from_radiance
from compose.image.gloss import DIFFUSE, GLOSSY, SPECULAR
from hybrid.plan.appearance import degree_decision, range_evidence
from hybrid.plan.decision import Decision
from hybrid.plan.layers import layers_decision
from hybrid.plan.look import Look, look_at_scene
from hybrid.plan.paths import MOST_BIAS, UNBOUNDED, path_decisions
from hybrid.plan.plan import plan_of
from hybrid.plan.samples import denoising_decision
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.image import trace_image
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.moving import moving_corner

NAMES = ["motion", "path depth", "roulette depth", "degree", "layers", "denoising", "light"]


def looked(
    gloss: np.ndarray, reflected: np.ndarray | None = None, radiance: np.ndarray | None = None
) -> Look:
    reflected = np.zeros(gloss.shape, dtype=bool) if reflected is None else reflected
    radiance = np.ones((*gloss.shape, 3), np.float32) if radiance is None else radiance
    return Look([], [radiance], [gloss], [reflected])


@pytest.mark.parametrize(("kind", "degree"), [(DIFFUSE, 0), (GLOSSY, 2), (SPECULAR, 2)])
def test_what_is_glossy_needs_harmonics(kind: int, degree: int):
    gloss = np.full((20, 20), DIFFUSE)
    gloss[:2, :2] = kind
    found = degree_decision(looked(gloss))
    assert (found.value, found.fixed) == (degree, 3)
    assert found.gain == pytest.approx(16 / (degree + 1) ** 2)


def test_a_flat_mirror_of_diffuse_things_needs_harmonics():
    gloss = np.full((20, 20), DIFFUSE)
    reflected = np.zeros((20, 20), dtype=bool)
    assert degree_decision(looked(gloss, reflected)).value == 0
    reflected[3:6] = True
    found = degree_decision(looked(gloss, reflected))
    assert found.value == 2
    assert found.evidence["specular"] == pytest.approx(0.15)


def test_the_range_counts_factors_of_two():
    radiance = np.ones((100, 100, 3), np.float32)
    radiance[:50] = 1 / 16
    found = range_evidence(looked(np.zeros((100, 100), dtype=int), radiance=radiance))
    assert found == {"stops": pytest.approx(4), "largest": 1.0}
    dark = looked(np.zeros((4, 4), dtype=int), radiance=np.zeros((4, 4, 3), np.float32))
    assert range_evidence(dark) == {"stops": 0.0, "largest": 0.0}


def test_a_larger_frame_can_tell_more_layers_apart():
    layers = [layers_decision(DISPLAYS["desktop"], size) for size in ((64, 64), (320, 240), (1920, 1080))]
    values = [decision.value for decision in layers]
    assert values == sorted(values)
    assert values[0] < values[-1] <= 4
    assert layers[0].gain > layers[-1].gain >= 1


def test_paths_are_as_long_as_they_bring_light(backend):
    """In a furnace of albedo 0.5, each segment halves what is left: 2^-8 is below half a percent."""
    scene = load_scene(small.furnace(0.5))
    depth, roulette = path_decisions(scene, [scene.camera], 0)
    assert depth.value in (8, 9)
    assert depth.fixed == UNBOUNDED
    assert depth.evidence["beyond"] < MOST_BIAS
    assert depth.evidence["beyond_own_depth"] == pytest.approx(0.5**scene.max_depth, rel=0.3)
    assert roulette.value in (3, 5, 8)
    assert roulette.gain >= 1


def test_a_still_scene_with_a_mirror_ball(backend):
    scene = load_scene(small.corner())
    found = plan_of(scene, DISPLAYS["desktop"], (1920, 1080))
    assert [decision.name for decision in found.decisions] == NAMES
    assert found.value("motion") == "still"
    assert found.value("degree") == 2
    assert 3 <= found.value("path depth") <= 6
    assert found.rows()[0] == found.decisions[0].row()
    assert set(found.rows()[0]) == set(Decision.__dataclass_fields__)


def test_noise_is_denoised_and_what_has_none_is_not(backend):
    noisy = load_scene(small.corner())
    found = denoising_decision(noisy, [View(noisy.camera.resized(64, 64))], 0)
    assert found.value == "denoised"
    assert found.gain > 2
    # A raw frame of as many samples as the denoised one has half the squared error.
    ahead = found.evidence["denoised_db"] - found.evidence["raw_db"] - 10 * np.log10(2)
    assert ahead == pytest.approx(10 * np.log10(found.gain))
    flat = load_scene(small.furnace(0.0))
    clean = denoising_decision(flat, [View(flat.camera.resized(64, 64))], 0)
    assert (clean.value, clean.gain) == ("raw", 1.0)
    assert clean.evidence["raw_db"] > 60


def test_raw_noise_is_that_of_many_frames(backend):
    """Against the variance over 48 frames of as many samples."""
    scene = load_scene(small.corner())
    camera, tracer = scene.camera.resized(48, 48), Tracer(scene)
    found = [denoising_decision(scene, [View(camera)], seed).evidence["raw_db"] for seed in range(6)]
    frames = [
        srgb_from_radiance(trace_image(tracer, camera, frame_positions(camera), 48, 4, seed).radiance)
        for seed in range(100, 148)
    ]
    variance = np.var(frames, axis=0, ddof=1).mean()
    assert -10 * np.log10(np.mean(10 ** (-np.array(found) / 10))) == pytest.approx(
        -10 * np.log10(variance), abs=0.7
    )


def test_a_scene_that_moves_is_looked_at_at_several_times(backend, tmp_path):
    scene = moving_corner(tmp_path)
    found = look_at_scene(scene, 0)
    assert len({view.time for view in found.views}) == len(found.views)
    assert scene.moving.time == 0
    again = look_at_scene(scene, 0)
    np.testing.assert_array_equal(found.gloss[2], again.gloss[2])
    np.testing.assert_allclose(found.radiance[2], again.radiance[2], rtol=1e-5)
