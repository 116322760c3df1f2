"""A scene in other units is the same scene: all lengths times s give the same frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import splat
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest
from tests import small
from tests.extremes import extreme
from tests.properties import twin
from tests.properties.chance import blocks, disagreement
from tests.properties.effort import tried
from tests.properties.random_scenes import random_scene
from tests.properties.similar import Similarity, scaling

RAW = FrameSettings(gaze=(0.4, 0.6), fov_a=40, fov_b=20, spp=4, fovea="raw", fill=False)


def splats_scaled_look_the_same(seed: int, scale: float) -> None:
    scene = random_scene(seed, most=150)
    by = scaling(scale)
    place = splat.Place(unit=scale)
    found = splat.render(by.gaussians(scene.gaussians), by.camera(scene.camera), place=place).double().numpy()
    image = splat.render(scene.gaussians, scene.camera).double().numpy()
    jumps = twin.rendered(scene.gaussians, scene.camera).jumps
    steady = ~np.logical_or.reduce(list(jumps.values()))
    error = np.abs(found - image)[steady] / np.maximum(1, image[steady])
    # Worst seen 2e-3, as under a rigid motion.
    assert error.max(initial=0) < 5e-3
    assert error.sum() <= 1e-4 * error.size


@tried(8)
@given(st.integers(0, 10_000), st.floats(0, 3))
def test_enlarged_splats_look_the_same(seed, exponent):
    splats_scaled_look_the_same(seed, 10.0**exponent)


@tried(8)
@given(st.integers(0, 10_000), st.floats(-3, 0))
def test_shrunken_splats_look_the_same(seed, exponent):
    splats_scaled_look_the_same(seed, 10.0**exponent)


@tried(4)
@given(st.integers(0, 10_000), st.floats(6, 12))
def test_splats_in_the_smallest_units_look_the_same(seed, exponent):
    splats_scaled_look_the_same(seed, 10.0**exponent)


def radiances(tracer: Tracer, spp: int, seeds: range) -> np.ndarray:
    """(R, H, W, 3)."""
    camera = tracer.scene.camera
    traced = (tracer.trace(camera, frame_positions(camera), spp, seed).radiance for seed in seeds)
    return np.array([interleaved(radiance).reshape(camera.height, camera.width, 3) for radiance in traced])


@pytest.mark.parametrize("scale", [1e-4, 1e-3, 1e3, 1e4])
def test_first_hits_scale_with_the_scene(backend, scale):
    """Relative to the distance; worst seen 7e-7."""
    one, other = (
        Tracer(s).hits(s.camera, frame_positions(s.camera))
        for s in (load_scene(scaling(k).scene(small.corner())) for k in (1.0, scale))
    )
    # In proportion to each other: a scene may have coordinates of its own.
    error, unfolded = (
        np.abs(
            getattr(other, name) / np.median(other.distance) / getattr(one, name) * np.median(one.distance)
            - 1
        )
        for name in ("distance", "unfolded")
    )
    assert np.median(error) < 1e-6
    # At outlines, a ray may pass on the other side.
    assert np.mean(error > 1e-4) < 0.01
    assert np.median(unfolded) < 1e-6
    assert np.mean(unfolded > 1e-4) < 0.01


@pytest.mark.parametrize("scale", [0.1, 10, 1e3])
def test_the_same_seed_traces_nearly_the_same_paths_in_a_scaled_scene(scene, scale):
    """Rays start off surfaces by a distance that does not scale: one path in a hundred goes elsewhere."""
    other = load_scene(scaling(scale).scene(small.corner()))
    one, other = (radiances(Tracer(s), 4, range(1))[0] for s in (scene, other))
    differs = (np.abs(other - one) > 1e-3 * np.maximum(one, 0.01)).any(axis=2)
    # Worst seen 1.6 %, at 0.1.
    assert differs.mean() < 0.05


@pytest.mark.parametrize("scale", [0.1, 1e3])
def test_radiance_is_the_same_on_average_in_a_scaled_scene(scene, scale):
    other = load_scene(scaling(scale).scene(small.corner()))
    one, other = (
        blocks(radiances(Tracer(s), 16, seeds)) for s, seeds in ((scene, range(24)), (other, range(50, 74)))
    )
    assert disagreement(one, other) < 1


@extreme(
    "path-traced room of 4 millimetres",
    given="a scene of 4 units, times 1e-3",
    expected="mean radiance within 0.2 %",
)
def test_a_tiny_scene_is_traced_as_the_scene_itself(scene, got):
    """Mitsuba's rays start 9e-5 (1 + |p|) off a surface: in the file's own units, 1 % more light passes."""
    tiny = load_scene(scaling(1e-3).scene(small.corner()))
    one, other = (radiances(Tracer(s), 64, range(4)).mean() for s in (scene, tiny))
    assert got(other / one, ".4f") == pytest.approx(1, abs=2e-3)


def scaled_renderer(renderer: Renderer, forest: Forest, scale: float) -> Renderer:
    """Of the scaled scene, with the forest in the coordinates that the scene was loaded in."""
    scaled, scene = load_scene(scaling(scale).scene(small.corner())), renderer.scene
    there, here = (
        float(np.median(Tracer(s).hits(s.camera, frame_positions(s.camera)).distance))
        for s in (scaled, scene)
    )
    origin = scaled.camera.position - there / here * scene.camera.position
    return Renderer(scaled, Similarity(np.eye(3), origin, there / here).forest(forest))


@pytest.mark.parametrize("scale", [0.003, 0.1, 10, 1000])
def test_a_scaled_composite_is_the_same(backend, forest, renderer, scale):
    """The splats to rounding, the disc on average."""
    scaled = scaled_renderer(renderer, forest, scale)
    runs = {r: [r.frame(RAW, seed) for seed in range(16)] for r in (renderer, scaled)}
    one, other = (runs[r][0] for r in (renderer, scaled))
    np.testing.assert_array_equal(other.region.weight_image() > 0, one.region.weight_image() > 0)
    np.testing.assert_allclose(other.periphery, one.periphery, atol=2e-3)
    images = (blocks(np.array([frame.composite for frame in runs[r]])) for r in (renderer, scaled))
    assert disagreement(*images) < 1


@pytest.mark.parametrize("scale", [1e-3, 100.0])
def test_depth_scales_with_the_scene(backend, forest, renderer, scale):
    scaled = scaled_renderer(renderer, forest, scale)
    one, other = (r.depth(r.scene.camera) for r in (renderer, scaled))
    np.testing.assert_allclose(np.median(other / one), scale, rtol=1e-6)
    settings = replace(RAW, fov_a=0, fov_b=0)
    np.testing.assert_allclose(scaled.splats(settings), renderer.splats(settings), atol=2e-3)
