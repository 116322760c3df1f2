"""Rendered frames: geometry that can be computed by hand, halves, and estimates from other samples."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.dataset.captured_frames import render_estimates, render_frame, render_with_halves
from pathtrace.scene.scene import load_scene
from pathtrace.trace.traced_images import denoise
from pathtrace.trace.tracer import Tracer
from tests import small

WIDTH, HEIGHT = 24, 16


@pytest.fixture(scope="module")
def view(backend):
    scene = load_scene(small.corner())
    return Tracer(scene), scene.camera.resized(WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def rendered(view):
    """A frame of 5 samples per pixel, and its halves."""
    return render_with_halves(*view, spp=5, seed=7)


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
    # Along the ray, it is farther.
    np.testing.assert_allclose(frame.unfolded, frame.depth * np.linalg.norm(local, axis=-1), rtol=1e-5)


def test_sky_is_infinitely_far_away(view):
    description = small.corner()
    del description["back"]
    scene = load_scene(description)
    frame = render_frame(Tracer(scene), scene.camera.resized(WIDTH, HEIGHT), 1, 0)
    sky = frame.shape == -1
    assert sky.any()
    assert np.isposinf(frame.depth[sky]).all()
    assert np.isposinf(frame.unfolded[sky]).all()


def test_halves_and_estimates_are_noisy_and_independent(backend):
    """In a closed sphere, where radiance is the same everywhere: errors of 4, 4 and 8 samples."""
    scene = load_scene(small.furnace())
    _, halves = render_with_halves(Tracer(scene), scene.camera, 8, 7)
    (estimate,) = render_estimates(Tracer(scene), scene.camera, (8,), 7)
    one, other, more = (part[..., 0].ravel() for part in (*halves, estimate.radiance))
    # 1024 pixels: the ratio of two variances, and a correlation, are known to about 10 and 3 %.
    assert one.var() / more.var() == pytest.approx(2, rel=0.4)
    assert other.var() / more.var() == pytest.approx(2, rel=0.4)
    for a, b in ((one, other), (one, more), (other, more)):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(len(a))


def test_views_with_neighbouring_seeds_share_no_samples(view):
    parts = [part.radiance for part in render_estimates(*view, (2, 2), 7)]
    parts += render_with_halves(*view, 4, 7)[1]
    assert len({part.tobytes() for part in parts}) == 4
    for seed in (6, 8):
        others = [part.radiance for part in render_estimates(*view, (2, 2), seed)]
        others += render_with_halves(*view, 4, seed)[1]
        assert not {part.tobytes() for part in parts} & {part.tobytes() for part in others}


def test_an_estimate_has_as_many_samples_as_it_says(backend):
    """The noise of two samples has four times the variance of that of eight."""
    scene = load_scene(small.furnace())
    few, many = (e.radiance.var() for e in render_estimates(Tracer(scene), scene.camera, (2, 8), 7))
    assert few / many == pytest.approx(4, rel=0.4)


def test_a_frame_is_the_denoised_mean_of_its_halves(view, rendered):
    """Of five samples, one half has three."""
    frame, (one, other) = rendered
    assert np.abs(one - other).mean() > 0
    expected = denoise(0.6 * one + 0.4 * other, frame.albedo, frame.normal)
    np.testing.assert_allclose(frame.radiance, expected, rtol=1e-3, atol=1e-3)


def test_the_same_seed_gives_the_same_frame(view):
    first, again, other = (render_frame(*view, 2, seed).radiance for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
