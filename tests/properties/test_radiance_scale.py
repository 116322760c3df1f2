"""Lights s times as strong give a frame s times as bright, as far as each part of it promises that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import splat
from compose.fusion.parents import Parents
from hybrid.base.compute_device import device_arrays
from hybrid.render.disc_images import parents_of
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import load_scene
from pathtrace.trace.traced_images import denoise
from splat.model.forest import Forest
from tests import small
from tests.extremes import extreme
from tests.properties.blending import blended
from tests.properties.effort import tried
from tests.properties.fused_images import fused_image
from tests.properties.random_scenes import random_scene
from tests.properties.similar import brighter, brighter_gaussians

SETTINGS = FrameSettings(gaze=(0.4, 0.6), fov_a=60, fov_b=40, spp=8, acuity_model="none", fill=False)
RAW = replace(SETTINGS, fovea="raw")


def brighter_forest(forest: Forest, factor: float) -> Forest:
    nodes = replace(forest.nodes, gaussians=brighter_gaussians(forest.nodes.gaussians, factor))
    return replace(forest, nodes=nodes, scene_name="", scene_hash="")


def lit(forest: Forest, factor: float) -> Renderer:
    """The scene and its forest under stronger lights."""
    return Renderer(load_scene(brighter(small.corner(), factor)), brighter_forest(forest, factor))


def error(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference relative to radiance, of the mean radiance where there is less."""
    found, expected = found.astype(np.float64), expected.astype(np.float64)
    return float((np.abs(found - expected) / np.maximum(expected, expected.mean())).max())


def factors(*values: float):
    """Cases of a test, each a row of the table."""
    marks = {
        v: extreme(
            f"raw fovea under {v:g} times the light",
            given=f"lamps of {12 * v:.3g}",
            expected="radiance scales to 1e-5",
        )
        for v in values
    }
    return [pytest.param(value, marks=mark) for value, mark in marks.items()]


@pytest.mark.parametrize("integrator", ["path", "cached"])
@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_a_raw_fovea_scales_with_the_light(own_home, forest, integrator, factor):
    """The same seed, the same paths."""
    settings = replace(RAW, integrator=integrator, fov_a=300, fov_b=0)
    one, other = (lit(forest, s).frame(settings, 2).composite for s in (1.0, factor))
    assert error(other / factor, one) < 1e-5


@pytest.mark.parametrize("factor", factors(1e-30, 1e-6, 1e6, 1e30))
def test_a_raw_fovea_scales_with_any_light(backend, forest, got, factor):
    settings = replace(RAW, fov_a=300, fov_b=0)
    one, other = (lit(forest, s).frame(settings, 2).composite for s in (1.0, factor))
    assert got(error(other.astype(np.float64) / factor, one), ".1e") < 1e-5


@tried(8)
@given(st.integers(0, 10_000), st.floats(-2, 4))
def test_splats_scale_with_their_radiance(seed, exponent):
    """Which the harmonics hold on a perceptual scale, so that these do not scale."""
    scene, factor = random_scene(seed, most=60), 10.0**exponent
    g = replace(scene.gaussians, sh=scene.gaussians.sh[:1].contiguous())
    one, other = (splat.render(brighter_gaussians(g, s), scene.camera).numpy() for s in (1.0, factor))
    # The scale is stored less 0.5: to 3e-8 of that, and radiance near 0 to 1/12.92 of it.
    np.testing.assert_allclose(other / factor, one, rtol=1e-5, atol=1e-8 * max(1, 1 / factor))


@tried(8)
@given(st.integers(0, 10_000), st.integers(-30, 30))
def test_the_blend_scales_exactly_by_powers_of_two(seed, power):
    scene, factor = random_scene(seed, most=2), np.float32(2.0**power)
    camera = scene.camera
    region = scene.foveation.region(camera.width, camera.height)
    periphery = (
        np.random.default_rng(seed).exponential(1, (camera.height, camera.width, 3)).astype(np.float32)
    )
    expected = blended(periphery, scene.fovea, region) * factor
    np.testing.assert_array_equal(blended(periphery * factor, scene.fovea * factor, region), expected)


@pytest.fixture(scope="module")
def parents(renderer) -> dict[str, np.ndarray]:
    """What a fused fovea of 64 x 64 pixels at 8 samples per pixel is made from."""
    frame = renderer.frame(
        replace(SETTINGS, camera=renderer.scene.camera.resized(64, 64), integrator="path"), 1
    )
    return parents_of(frame.fovea.disc, frame.fovea.samples, frame.underlay).images()


def deviation(found: np.ndarray, expected: np.ndarray) -> float:
    """Root mean square of the difference, relative to that of the expectation."""
    difference = found.astype(np.float64) - expected
    return float(np.sqrt(np.mean(difference**2) / np.mean(expected.astype(np.float64) ** 2)))


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("factor", [1e-30, 1e-12, 1e-6, 1e-3, 1e3, 1e12, 1e30])
def test_the_denoiser_is_homogeneous(parents, factor, quick):
    """Worst seen 4e-6; without a common exponent, the least light came out as 1e-6 of noise of its own."""
    scale = np.float32(factor)
    traced, albedo = parents["traced"], parents["albedo"]
    expected = denoise(traced, albedo, 0 * albedo, quick)
    found = denoise(traced * scale, albedo, 0 * albedo, quick)
    assert deviation(found.astype(np.float64) / factor, expected) < 2e-5


def fused(parents: dict[str, np.ndarray]) -> np.ndarray:
    return fused_image(Parents.of_images(device_arrays(), parents))


def scaled(parents: dict[str, np.ndarray], factor: float) -> dict[str, np.ndarray]:
    s = np.float32(factor)
    images = {name: parents[name] * s for name in ("traced", "denoised", "splat")}
    return {**parents, **images, "variance": parents["variance"] * s * s}


@pytest.mark.parametrize(
    ("factor", "bound"), [(1e-3, 0.1), (1e-2, 0.02), (0.1, 1e-3), (10, 1e-5), (1e3, 1e-5), (1e6, 1e-5)]
)
def test_statistical_fusion_is_homogeneous_for_ordinary_light(parents, factor, bound):
    """Below a radiance of some 1e-4, what counts as no light at all is not: its parents differ otherwise."""
    expected, found = (fused(of) for of in (parents, scaled(parents, factor)))
    assert deviation(found.astype(np.float64) / factor, expected) < bound


def test_fusion_of_very_bright_light_is_finite(parents):
    assert np.isfinite(fused(scaled(parents, 1e12))).all()


@pytest.mark.parametrize(("factor", "bound"), [(1e-4, 0.03), (1e4, 0.03)])
def test_a_denoised_fovea_scales_with_the_light_within_3_percent(own_home, forest, factor, bound):
    """Around the disc, the splats' radiance, clipped to 1, stands in for the albedo; worst seen 1.1 %."""
    settings = replace(SETTINGS, fovea="denoised")
    one, other = (lit(forest, s).frame(settings, 1).composite for s in (1.0, factor))
    assert deviation(other.astype(np.float64) / factor, one) < bound
