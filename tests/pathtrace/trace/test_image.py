"""Traced images: orientation, samples, and what denoising does to them."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import box_positions, frame_positions
from pathtrace.trace.traced_images import auxiliary_images, denoise, radiance_image, trace_image
from pathtrace.trace.tracer import Tracer
from tests import small

WIDTH, HEIGHT = 24, 16


@pytest.fixture(scope="module")
def scene(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture(scope="module")
def view(scene):
    """Tracer, camera, film positions and width of a frame, as the functions take them."""
    camera = scene.camera.resized(WIDTH, HEIGHT)
    return Tracer(scene), camera, frame_positions(camera), WIDTH


def test_rows_run_from_the_top_and_columns_from_the_left(view):
    """What the camera projects to a pixel has its colour there."""
    _, camera, _, _ = view
    albedo, normal = auxiliary_images(*view, spp=4, pattern=0)
    assert albedo.shape == normal.shape == (HEIGHT, WIDTH, 3)
    assert albedo.dtype == normal.dtype == np.float32
    points = np.array([[-0.6, 0.1, 1.2], [-0.6, 1.5, 2.0]])  # on the blue board, and on the wall above it
    (board, wall), _ = camera.project(points)
    np.testing.assert_allclose(albedo[int(board[1]), int(board[0])], [0.2, 0.3, 0.8], atol=1e-5)
    np.testing.assert_allclose(albedo[int(wall[1]), int(wall[0])], [0.7, 0.6, 0.3], atol=1e-5)
    radiance = radiance_image(*view, 16, 0)
    assert radiance.shape == (HEIGHT, WIDTH, 3)
    assert radiance[int(board[1]), int(board[0])].argmax() == 2
    assert radiance[int(wall[1]), int(wall[0])].argmax() == 0


def test_columns_are_the_images_not_the_cameras(view):
    """Boxes of 2 x 2 pixels make an image of half the width."""
    tracer, camera, *_ = view
    left, top = (side.ravel() for side in np.meshgrid(np.arange(0, WIDTH, 2.0), np.arange(0, HEIGHT, 2.0)))
    positions = box_positions(left, top, np.full(left.shape, 2.0), np.full(left.shape, 2.0))
    albedo, _ = auxiliary_images(tracer, camera, positions, WIDTH // 2, spp=64, pattern=0)
    whole, _ = auxiliary_images(*view, spp=64, pattern=0)
    assert albedo.shape == (HEIGHT // 2, WIDTH // 2, 3)
    expected = whole.reshape(HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(albedo, expected, atol=0.05)


def test_a_traced_image_has_radiance_and_features_of_one_seed(view):
    traced = trace_image(*view, spp=6, seed=3)
    np.testing.assert_array_equal(traced.radiance, radiance_image(*view, 6, 3))
    for found, expected in zip((traced.albedo, traced.normal), auxiliary_images(*view, 6, 3), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-6)
    # A single sample of the features would be too noisy: they have four; more than 16 help no longer.
    for spp, of_features in ((1, 4), (17, 16)):
        albedo, _ = auxiliary_images(*view, of_features, 3)
        np.testing.assert_allclose(trace_image(*view, spp=spp, seed=3).albedo, albedo, atol=1e-6)
    assert not np.array_equal(trace_image(*view, spp=6, seed=4).radiance, traced.radiance)


@pytest.mark.parametrize(("spp", "wanted"), [(1, 4), (2, 4), (6, 6), (20, 16)])
def test_auxiliary_features_may_have_other_numbers_of_samples_than_radiance(view, spp, wanted):
    traced = trace_image(*view, spp, seed=3)
    np.testing.assert_array_equal(traced.radiance, radiance_image(*view, spp, 3))
    albedo, normal = auxiliary_images(*view, wanted, pattern=3)
    np.testing.assert_allclose(traced.albedo, albedo, atol=1e-5)
    np.testing.assert_allclose(traced.normal, normal, atol=1e-5)


def test_positions_may_have_different_numbers_of_samples(view):
    """Where there are 64 times as many samples, there is less noise."""
    counts = np.where(np.arange(WIDTH * HEIGHT) % 2, 64, 1)
    truth = radiance_image(*view, 1024, 9)
    squares = ((radiance_image(*view, counts, 0) - truth) ** 2).reshape(-1, 3)
    assert squares[counts == 64].mean() < squares[counts == 1].mean() / 8


def test_denoising_uses_the_images_own_features(view):
    traced = trace_image(*view, spp=4, seed=1)
    named = {"radiance": traced.radiance, "albedo": traced.albedo, "normal": traced.normal}
    np.testing.assert_array_equal(traced.denoised(), denoise(**named))
    np.testing.assert_array_equal(traced.denoised(quick=True), denoise(**named, quick=True))
    assert not np.array_equal(traced.denoised(), traced.denoised(quick=True))
    assert not np.array_equal(traced.denoised(), traced.radiance)
