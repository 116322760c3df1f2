"""Rendered frames: geometry that can be computed by hand, and noise of their own."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from pathtrace.dataset.captured_frames import render_frame
from pathtrace.scene.scene import load_scene
from pathtrace.trace.traced_images import trace_frame
from pathtrace.trace.tracer import Tracer
from tests import small

WIDTH, HEIGHT = 24, 16


@pytest.fixture(scope="module")
def view(backend):
    scene = load_scene(small.corner())
    return Tracer(scene), scene.camera.resized(WIDTH, HEIGHT)


def test_depth_is_along_the_view_axis(view):
    """Points at that depth on each pixel's ray lie on the wall at z = 2, the board at 1.2 or the ball."""
    _, camera = view
    frame = render_frame(*view, spp=5, seed=7)
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


def test_a_frame_is_its_samples_denoised(view):
    frame = render_frame(*view, spp=5, seed=7)
    traced = trace_frame(*view, 5, 7)
    assert np.abs(frame.radiance - traced.radiance).mean() > 0
    np.testing.assert_array_equal(frame.radiance, traced.denoised())


def test_neighbouring_seeds_share_no_noise(backend):
    """In a closed sphere, where radiance is the same everywhere."""
    scene = load_scene(small.furnace())
    noise = [trace_frame(Tracer(scene), scene.camera, 4, seed).radiance[..., 0].ravel() for seed in (6, 7, 8)]
    for a, b in combinations(noise, 2):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(len(a))


def test_the_same_seed_gives_the_same_frame(view):
    first, again, other = (render_frame(*view, 2, seed).radiance for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
