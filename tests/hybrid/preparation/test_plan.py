"""What a scene requires, against what a careful person would write."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.base.traced_samples import DIFFUSE, GLOSSY, SPECULAR
from compose.eye.display import DISPLAYS
from compose.image.colour import srgb_from_radiance
from hybrid.preparation.decisions import (
    FIXED_GAUSSIANS,
    GAUSSIANS,
    HALF,
    MOST_BIAS,
    REGION,
    SINGLE,
    Decision,
    degree_decision,
    frame_precision_decision,
    gaussians_decision,
    layers_decision,
    parsed,
    path_decisions,
    planned_needs,
    sample_decisions,
)
from hybrid.preparation.scene_look import Look, look_at_scene, traced_halves
from hybrid.preparation.scene_plan import ScenePlan, overridden, plan_of
from hybrid.preparation.stages import Needs
from pathtrace.region import region_of
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.path_depths import UNBOUNDED
from pathtrace.trace.traced_images import TracedImage, trace_image
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.moving import moving_corner
from tests.splat.training.frames import SIZE, WALLS

NAMES = ["motion", "region", "path depth", "roulette depth", "degree", "frame precision", "layers"]
NAMES += ["gaussians", "samples", "denoising", "light"]


def looked(
    gloss: np.ndarray,
    reflected: np.ndarray | None = None,
    radiance: np.ndarray | None = None,
    parallax: float = 0.2,
) -> Look:
    reflected = np.zeros(gloss.shape, dtype=bool) if reflected is None else reflected
    radiance = np.ones((*gloss.shape, 3), np.float32) if radiance is None else radiance
    return Look([], [radiance], [gloss], [reflected], [], [], parallax)


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


def test_what_is_seen_from_one_point_needs_none():
    glossy = np.full((20, 20), GLOSSY)
    assert degree_decision(looked(glossy)).value == 2
    assert degree_decision(looked(glossy, parallax=1e-4)).value == 0


def test_the_range_counts_factors_of_two_and_decides_the_precision_of_frames():
    radiance = np.ones((100, 100, 3), np.float32)
    radiance[:50] = 1 / 16
    found = frame_precision_decision(looked(np.zeros((100, 100), dtype=int), radiance=radiance))
    assert found.evidence == {"stops": pytest.approx(4), "largest": 1.0}
    assert (found.value, found.gain) == (HALF, 2.0)
    dark = looked(np.zeros((4, 4), dtype=int), radiance=np.zeros((4, 4, 3), np.float32))
    assert frame_precision_decision(dark).evidence == {"stops": 0.0, "largest": 0.0}


def test_frames_of_blue_light_beyond_half_precision_are_kept_as_they_are():
    """Its luminance, a fourteenth of it, would fit."""
    radiance = np.zeros((10, 10, 3), np.float32)
    radiance[2, 2, 2] = 1e5
    found = frame_precision_decision(looked(np.zeros((10, 10), dtype=int), radiance=radiance))
    assert (found.value, found.gain, found.evidence["largest"]) == (SINGLE, 1.0, 1e5)


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
    assert depth.evidence["needed"] in (8, 9)
    # Hardly any path is longer, so that a bound saves nothing.
    assert depth.value == depth.fixed == UNBOUNDED
    assert depth.gain == 1
    assert depth.evidence["beyond"] < MOST_BIAS
    assert depth.evidence["beyond_own_depth"] == pytest.approx(0.5**scene.max_depth, rel=0.3)
    assert roulette.value in (3, 5, 8)
    assert roulette.gain >= 1


def test_a_still_scene_with_a_mirror_ball(backend):
    scene = load_scene(small.corner())
    found = plan_of(scene, DISPLAYS["desktop"], (1920, 1080))
    assert [decision.name for decision in found.decisions] == NAMES
    assert found.values()["motion"] == "still"
    assert found.values()["degree"] == 2
    assert 3 <= found.decisions[2].evidence["needed"] <= 6
    assert found.rows()[0] == asdict(found.decisions[0])
    assert set(found.rows()[0]) == set(Decision.__dataclass_fields__)


def halved(scene: Scene, side: int, seed: int = 0) -> Look:
    """A look that has halves of one view only."""
    halves = traced_halves(Tracer(scene), scene.camera.resized(side, side), seed)
    return replace(looked(np.zeros((4, 4), dtype=int)), halves=[halves], larger=[(None, None)])


def test_noise_is_denoised_and_what_has_none_is_not(backend):
    samples, found = sample_decisions(halved(load_scene(small.corner()), 64))
    assert found.value == "denoised"
    assert found.gain > 2
    # A raw frame of as many samples as the denoised one has half the squared error.
    ahead = found.evidence["denoised_db"] - found.evidence["raw_db"] - 10 * np.log10(2)
    assert ahead == pytest.approx(10 * np.log10(found.gain))
    # As many samples as frames of 35 dB take at 1.5 dB per doubling, rounded up.
    doublings = np.ceil((35 - samples.evidence["db"]) / 1.5)
    assert samples.value == np.clip(8 * 2.0**doublings, 16, 128)
    few, clean = sample_decisions(halved(load_scene(small.furnace(0.0)), 64))
    assert (clean.value, clean.gain) == ("raw", 1.0)
    assert clean.evidence["raw_db"] > 60
    assert few.value == 16


def test_raw_noise_is_that_of_many_frames(backend):
    """Against the variance over 48 frames of as many samples."""
    scene = load_scene(small.corner())
    camera, tracer = scene.camera.resized(48, 48), Tracer(scene)
    found = [sample_decisions(halved(scene, 48, seed))[1].evidence["raw_db"] for seed in range(6)]
    frames = [
        srgb_from_radiance(trace_image(tracer, camera, frame_positions(camera), 48, 4, seed).radiance)
        for seed in range(100, 148)
    ]
    variance = np.var(frames, axis=0, ddof=1).mean()
    assert -10 * np.log10(np.mean(10 ** (-np.array(found) / 10))) == pytest.approx(
        -10 * np.log10(variance), abs=0.7
    )


def test_more_detail_takes_more_gaussians():
    """Of a wall: in one colour, noisy in a corner, and noisy all over."""
    rng, camera = np.random.default_rng(0), WALLS[0].camera
    counts = []
    for share in (0.0, 0.25, 1.0):
        radiance = np.full((SIZE, SIZE, 3), 0.5, np.float32)
        side = round(SIZE * share**0.5)
        radiance[:side, :side] = rng.random((side, side, 3))
        # What albedo shows is no noise, to the denoiser.
        image = TracedImage(radiance, radiance, np.zeros_like(radiance))
        wall = (camera, np.full((SIZE, SIZE), 2.0, np.float32))
        look = replace(looked(np.zeros((4, 4), dtype=int)), halves=[(image, image)], larger=[wall])
        decision = gaussians_decision(look, 1.0)
        counts.append(decision.value)
        if share:
            assert gaussians_decision(look, 4.0).value == pytest.approx(4**0.7 * decision.value, rel=0.1)
        curve = list(decision.evidence["error_db"].values())
        assert curve == sorted(curve)
    assert counts[0] < 500
    # No bound on how much more that is.
    assert 5 * counts[0] < counts[1] < 0.75 * counts[2]


def test_where_no_surface_is_seen_a_scene_takes_few_gaussians():
    sky = np.full((SIZE, SIZE, 3), 0.5, np.float32)
    image = TracedImage(sky, sky, np.zeros_like(sky))
    nothing = (WALLS[0].camera, np.full((SIZE, SIZE), np.inf, np.float32))
    look = replace(looked(np.zeros((4, 4), dtype=int)), halves=[(image, image)], larger=[nothing])
    assert gaussians_decision(look, 1.0).value == 100


def test_a_scene_that_moves_is_looked_at_at_several_times(backend, tmp_path):
    scene = moving_corner(tmp_path)
    surfaces = scene.surfaces()
    near = region_of(scene, surfaces, "near")
    found = look_at_scene(scene, surfaces, near, 0)
    assert len({view.time for view in found.views}) == len(found.views)
    assert scene.moving.time == 0
    again = look_at_scene(scene, surfaces, near, 0)
    np.testing.assert_array_equal(found.gloss[2], again.gloss[2])
    np.testing.assert_allclose(found.radiance[2], again.radiance[2], rtol=1e-5)


def test_broad_regions_take_more_gaussians_but_not_as_many_times_more():
    plain, broad = Needs(1.0, 0.8), Needs(4.0, 0.8)
    assert plain.gaussians < broad.gaussians < 4 * plain.gaussians


@pytest.mark.parametrize(
    ("planned_for", "region", "gaussians"),
    [("near", "near", 0.7), ("reachable", "reachable", 0.7), ("near", "reachable", 0.7 * 3**0.7)],
)
def test_gaussians_are_those_of_the_plan(planned_for, region, gaussians):
    """Those of a plan for the default region grow with the region."""
    plan = {GAUSSIANS: round(0.7 * FIXED_GAUSSIANS), REGION: planned_for}
    breadth = 1.0 if region == "near" else 3.0
    found = planned_needs(plan, region, breadth)
    assert found.gaussians == pytest.approx(gaussians)
    assert found.breadth == breadth


def test_a_plan_for_another_region_tells_nothing():
    plan = {GAUSSIANS: 100, REGION: "reachable"}
    assert planned_needs(plan, "near", 1.0) == planned_needs({}, "near", 1.0) == Needs()


def test_an_item_is_decided_by_the_user():
    depth = Decision("path depth", 9, -1, {"beyond": 0.001}, 1.5, "segments per path")
    plan = ScenePlan("any", "hash", (depth, Decision("degree", 2, 3, {}, 1.8, "harmonics")))
    found = overridden(plan, parsed(["path depth = 12"]))
    assert found.values() == {"path depth": 12, "degree": 2}
    assert found.decisions[0].evidence == {"planned": 9, "beyond": 0.001}
    assert found.decisions[0].gain == 1
    assert found.decisions[1] is plan.decisions[1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("degree", "must be NAME=VALUE"),
        ("degree=4", "must be a whole number from 0 to 3"),
        ("degree=-1", "must be a whole number"),
        ("path depth=0", "from 1 to 1000000"),
        ("layers=" + "9" * 5000, "must be a whole number"),
        ("denoising=maybe", "must be denoised or raw"),
        ("motion=still", "the scene decides all else"),
        ("colour=red", "must be one of path depth"),
    ],
)
def test_what_cannot_be_decided_is_refused(text: str, said: str):
    with pytest.raises(UserError, match=said):
        parsed([text])
