"""Rendered frames: geometry that can be computed by hand, and estimates from disjoint samples."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.base.denoise import denoise
from pathtrace.dataset.rendering import render_frame, render_with_estimates
from pathtrace.scene.scene import load_scene
from pathtrace.trace.tracer import Tracer
from tests import small

WIDTH, HEIGHT = 24, 16


@pytest.fixture(scope="module")
def view(backend):
    scene = load_scene(small.corner())
    return Tracer(scene), scene.camera.resized(WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def rendered(view):
    """A frame of 16 samples per pixel, with estimates of 2 and 5."""
    return render_with_estimates(*view, spp=16, seed=7, estimate_spp=(2, 5))


def test_depth_is_along_the_view_axis(view, rendered):
    """Points at that depth on each pixel's ray lie on the wall at z = 2, the board at 1.2 or the ball."""
    _, camera = view
    frame, _ = rendered
    assert frame.depth.shape == frame.unfolded.shape == frame.shape.shape == (HEIGHT, WIDTH)
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    local = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=-1)
    points = (local * frame.depth[..., None]) @ camera.camera_to_world[:3, :3].T + camera.position
    walls = np.isclose(points[..., 2], 2, atol=1e-3) | np.isclose(points[..., 2], 1.2, atol=1e-3)
    ball = np.isclose(np.linalg.norm(points - [0.5, -0.1, 1.0], axis=-1), 0.35, atol=1e-3)
    assert (walls | ball).mean() > 0.98
    assert walls.any()
    assert ball.any()
    # Along the ray, it is farther; what the mirror ball shows, farther still.
    assert (frame.unfolded >= frame.depth * np.linalg.norm(local, axis=-1) * (1 - 1e-5)).all()
    assert (frame.unfolded > frame.depth * 1.5)[ball].any()


def test_sky_is_infinitely_far_away(view):
    description = small.corner()
    del description["back"]
    scene = load_scene(description)
    frame = render_frame(Tracer(scene), scene.camera.resized(WIDTH, HEIGHT), 1, 0)
    sky = frame.shape == -1
    assert sky.any()
    assert np.isposinf(frame.depth[sky]).all()
    assert np.isposinf(frame.unfolded[sky]).all()


def test_estimates_are_noisy_and_independent(backend):
    """In a closed sphere, where radiance is the same everywhere: errors of 4, 4 and 8 samples."""
    scene = load_scene(small.furnace())
    _, estimates = render_with_estimates(Tracer(scene), scene.camera, 17, 7, (4, 4, 8))
    one, other, more = (part.radiance[..., 0].ravel() for part in estimates)
    # 1024 pixels: the ratio of two variances, and a correlation, are known to about 10 and 3 %.
    assert one.var() / more.var() == pytest.approx(2, rel=0.4)
    assert other.var() / more.var() == pytest.approx(2, rel=0.4)
    for a, b in ((one, other), (one, more), (other, more)):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(len(a))


def test_frames_with_neighbouring_seeds_share_no_estimates(view):
    _, parts = render_with_estimates(*view, 5, 7, (2, 2))
    for seed in (6, 8):
        _, others = render_with_estimates(*view, 5, seed, (2, 2))
        for part in parts:
            assert not any(np.array_equal(part.radiance, other.radiance) for other in others)


def test_a_frame_is_the_denoised_mean_of_all_its_samples(view, rendered):
    """As such, it is that of estimates and rest weighted by their samples: 2, 5 and 9 of 16."""
    tracer, camera = view
    frame, estimates = rendered
    # The third part as an estimate of its own; what is left of 17 then is another sample.
    _, parts = render_with_estimates(tracer, camera, 17, 7, (2, 5, 9))
    for found, part in zip(estimates, parts[:2], strict=True):
        np.testing.assert_array_equal(found.radiance, part.radiance)
    names = ("radiance", "albedo", "normal")
    mean = {
        name: np.average([getattr(part, name) for part in parts], axis=0, weights=[2, 5, 9]) for name in names
    }
    np.testing.assert_allclose(frame.albedo, mean["albedo"], atol=1e-6)
    np.testing.assert_allclose(frame.normal, mean["normal"], atol=1e-6)
    expected = denoise(*(mean[name].astype(np.float32) for name in names))
    np.testing.assert_allclose(frame.radiance, expected, rtol=1e-3, atol=1e-4)


def test_the_same_seed_gives_the_same_frame(view):
    first, again, other = (render_frame(*view, 2, seed).radiance for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
